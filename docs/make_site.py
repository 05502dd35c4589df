"""Build the documentation site into ``site``: ``make docs``.

The pages of ``docs`` are copied to ``build/docs``. Pages of reference are written there from the options of
the commands and from the docstrings of the public functions, and quick pictures are drawn. Zensical makes the
site of them (``zensical.toml``). Equations become drawings, which need no script and no font of the reader.
"""

from __future__ import annotations

import csv
import html
import inspect
import re
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterable, Iterator
from functools import cached_property, partial
from importlib import import_module
from pathlib import Path
from typing import Any

import click
import griffe
import ziamath
from pictures import draw_quick
from reference import PYTHON

from swimid.api import NAMES
from swimid.cli.main import SHARED, Command, main
from swimid.commands import COMMAND_SPECS, TABLE

ROOT = Path(__file__).parents[1]
PAGES, SITE = ROOT / "build" / "docs", ROOT / "site"
#: Script that Zensical loads for a search without a server. ``docs/site.js`` takes its place.
FOREIGN_SCRIPT = "https://unpkg.com/iframe-worker/shim"
#: Equation of a page, as the Markdown extension arithmatex leaves it.
EQUATION = re.compile(r'<(span|div) class="arithmatex">\s*\\(?P<open>[\[(])(?P<tex>.*?)\\[\])]\s*</\1>', re.S)
#: Font size of equations, px.
EQUATION_PX = 17


def slug(title: str) -> str:
    """Return the name of the file of a page."""
    return title.lower().replace(" ", "-").replace(",", "")


# ---------------------------------------------------------------- pages of docs


def copy_pages() -> None:
    """Copy the pages of ``docs`` and the documents beside it, with their links adapted."""
    shutil.rmtree(PAGES, ignore_errors=True)
    shutil.copytree(ROOT / "docs", PAGES, ignore=shutil.ignore_patterns("__pycache__", "llms.txt"))
    for name in ("CONTRIBUTING.md", "CHANGELOG.md"):
        text = (ROOT / name).read_text(encoding="utf-8")
        (PAGES / name).write_text(text.replace("](docs/", "]("), encoding="utf-8")
    places = {name: f"reference/{slug(spec.section)}.md" for name, spec in COMMAND_SPECS.items()}
    for path in PAGES.rglob("*.md"):
        up = "../" * (len(path.relative_to(PAGES).parts) - 1)
        text = path.read_text(encoding="utf-8").replace("](../CONTRIBUTING.md", f"]({up}CONTRIBUTING.md")
        for name, place in places.items():  # The options of a command are a page of the site.
            link = f"[`swimid {name} --help`]({up}{place}#{slug(name)})"
            text = text.replace(f"`swimid {name} --help`", link)
        text = re.sub(r"^\[All rows\]\((.+\.csv)\)$", partial(with_table, path.parent), text, flags=re.M)
        path.write_text(text, encoding="utf-8")


def with_table(folder: Path, link: re.Match[str]) -> str:
    """Return the link to a CSV file, and its content as a table."""
    with (folder / link[1]).open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    cells = (head, ["---"] * len(head), *rows)
    return "\n".join([f"{link[0]}\n", *(f"| {' | '.join(row)} |" for row in cells)])


# ---------------------------------------------------------------- reference of the commands


def command_pages() -> None:
    """Write a page for each section of the list of commands, with the help of its commands."""
    folder = PAGES / "reference"
    for section in TABLE:
        specs = [spec for spec in COMMAND_SPECS.values() if spec.section == section]
        text = [f"# {section}\n"]
        for spec in sorted(specs, key=lambda one: one.command):
            text += command_text(spec.command)
        write(folder / f"{slug(section)}.md", text)
    shared = [
        "# Options of every command\n",
        "Every command has `-h`, and these options. Exit status: 0 done, 2 wrong usage, 3 bad input, 4 no",
        "trustworthy result, 130 interrupted, 1 a bug.\n",
        *option_table(SHARED),
    ]
    write(folder / "shared-options.md", shared)


def command_text(name: str) -> Iterator[str]:
    """Yield the Markdown lines of one command: help, usage and options with their defaults."""
    group: Any = main
    for word in name.split():
        group = group.commands[word]
    command: Command = group
    context = click.Context(command, info_name=f"swimid {name}")
    about, _, examples = inspect.cleandoc(command.spec.model().__doc__).partition("\n\nExample")
    usage = [command.get_usage(context).removeprefix("Usage: ")]
    usage += [line.strip() for line in examples.splitlines() if line.strip().startswith("swimid ")]
    yield f"## swimid {name} {{ #{slug(name)} }}\n"
    yield f"{escaped(about)}\n"
    yield from ("```", *usage, "```\n")
    yield from option_table(one for one in command.get_params(context) if one not in SHARED)
    yield "[Options of every command](shared-options.md)\n"


def option_table(parameters: Iterable[click.Parameter]) -> Iterator[str]:
    """Yield a Markdown table of options: flags and values, default, and meaning."""
    yield "| option | default | meaning |"
    yield "|---|---|---|"
    for one in parameters:
        if isinstance(one, click.Option) and one.name != "help":
            flags, meaning = one.get_help_record(click.Context(click.Command("swimid"))) or ("", "")
            default = re.search(r"default: ([^;\]]+)", meaning)
            meaning = re.sub(r"\s*\[(default|required)[^]]*\](\.?)$", r"\2", meaning)
            state = f"`{default[1]}`" if default else "required" if one.required else ""
            code = html.escape(flags).replace("|", "&#124;")
            yield f"| <code>{code}</code> | {state} | {escaped(meaning).replace('|', '&#124;')} |"
    yield ""


# ---------------------------------------------------------------- reference of the Python functions


def python_pages() -> None:
    """Write the pages of the public functions and classes.

    Raises
    ------
    ValueError
        If a public name is on no page, or a page has a name that is not public.
    """
    listed = [name for names in PYTHON.values() for name in names]
    if sorted(listed) != sorted(NAMES):
        raise ValueError(f"PYTHON does not list the public names: {set(listed) ^ set(NAMES)}")
    for title, names in PYTHON.items():
        text = [f"# {title}\n"]
        for name in names:
            text += object_text(name, getattr(import_module(NAMES[name]), name))
        write(PAGES / "reference" / "python" / f"{slug(title)}.md", text)


def object_text(name: str, item: Any) -> Iterator[str]:
    """Yield the Markdown lines of one public function or class."""
    yield f"## swimid.{name} {{ #{slug(name)} }}\n"
    if not issubclass_of_exception(item):
        yield from ("```python", signature_text(name, item), "```\n")
    yield from docstring_text(inspect.getdoc(item) or "")
    if not inspect.isclass(item) or issubclass_of_exception(item):
        return
    for member, value in vars(item).items():
        if member.startswith("_") or not (doc := inspect.getdoc(getattr(item, member))):
            continue
        if isinstance(value, property | cached_property):
            yield f"### .{member} {{ #{slug(name)}.{member} }}\n"
        elif inspect.isroutine(value):
            yield f"### .{member}() {{ #{slug(name)}.{member} }}\n"
            yield from ("```python", signature_text(member, getattr(item, member), "."), "```\n")
        else:
            continue
        yield from docstring_text(doc)


def issubclass_of_exception(item: Any) -> bool:
    """Return whether a public name is a class of errors or warnings, whose arguments are of no interest."""
    return inspect.isclass(item) and issubclass(item, Exception)


def signature_text(name: str, item: Any, module: str = "swimid.") -> str:
    """Return the call of a function without annotations, which the table of its parameters has."""
    try:
        parameters = inspect.signature(item).parameters.values()
    except ValueError:  # A class with a constructor in C.
        return f"{module}{name}"
    bare = [one.replace(annotation=one.empty) for one in parameters if one.name not in ("self", "progress")]
    call = f"{module}{name}{inspect.Signature(bare)}"
    return textwrap.fill(call, 76, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)


def docstring_text(text: str) -> Iterator[str]:
    """Yield the Markdown lines of a docstring in numpydoc form."""
    for section in griffe.Docstring(text).parse("numpy", warnings=False):
        yield from section_text(section)


def section_text(section: Any) -> Iterator[str]:
    """Yield the Markdown lines of one section of a docstring."""
    kinds = griffe.DocstringSectionKind
    if section.kind is kinds.text:
        yield f"{marked(section.value)}\n"
        return
    if section.kind is kinds.admonition:
        yield f"**{section.title}**\n"
        yield f"{marked(section.value.description)}\n"
        return
    yield f"**{(section.title or section.kind.value).capitalize()}**\n"
    if section.kind is kinds.examples:
        for kind, value in section.value:
            if kind is kinds.examples:
                yield from ("```pycon", value, "```\n")
            else:
                yield f"{marked(value)}\n"
        return
    for one in section.value:
        name, kind = getattr(one, "name", ""), str(one.annotation or "")
        head = ", ".join(part for part in (name and f"`{name}`", kind and f"*{escaped(kind)}*") if part)
        yield f"- {head}: {' '.join(marked(one.description).split())}"
    yield ""


def marked(text: str) -> str:
    """Turn the marks of a docstring into those of Markdown."""
    text = re.sub(r":\w+:`~?(?:[\w.]*\.)?(\w+)`", r"`\1`", text)
    text = re.sub(r"``(.+?)``", r"`\1`", text)
    text = re.sub(r"^\.\. \[(\d+)\] ", r"\1. ", text, flags=re.M)
    return re.sub(r"`docs/([\w-]+\.md)`", r"[\1](../../\1)", escaped(text))


def escaped(text: str) -> str:
    """Escape what Markdown would take for a tag or an emphasis, outside of code."""
    parts = re.split(r"(`[^`]*`)", text)
    for k in range(0, len(parts), 2):
        parts[k] = re.sub(r"([*_\[])", r"\\\1", parts[k].replace("<", "&lt;"))
    return "".join(parts)


def write(path: Path, lines: Iterable[str]) -> None:
    """Write a page of reference."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines), encoding="utf-8")


# ---------------------------------------------------------------- site


def drawn_equation(found: re.Match[str]) -> str:
    """Return the HTML of an equation: its drawing, with its LaTeX as text for readers who cannot see it."""
    tex, inline = html.unescape(found["tex"]).strip(), found["open"] == "("
    drawing = ziamath.Latex(tex, size=EQUATION_PX, inline=inline, color="currentColor")
    tag, depth = ("span", f"{drawing.getyofst():.2f}px") if inline else ("div", "0")
    attributes = (
        f'class="equation" role="img" aria-label="{html.escape(tex)}" style="vertical-align: {depth}"'
    )
    return f"<{tag} {attributes}>{drawing.svg()}</{tag}>"


def finish(page: Path) -> None:
    """Draw the equations of a page of the site, and replace the script of another server by ``site.js``."""
    text = EQUATION.sub(drawn_equation, page.read_text(encoding="utf-8"))
    up = "../" * (len(page.relative_to(SITE).parts) - 1)
    page.write_text(text.replace(FOREIGN_SCRIPT, f"{up}site.js"), encoding="utf-8")


def build() -> int:
    """Build the site. Return the exit status of Zensical, which is not 0 after a warning."""
    copy_pages()
    draw_quick(PAGES / "figures")
    command_pages()
    python_pages()
    words = [sys.executable, "-m", "zensical", "build", "--clean", "--strict"]
    ziamath.config.svg2 = False  # glyphs of two equations would share names
    status = subprocess.run(words, cwd=ROOT, check=False).returncode
    if status == 0:
        for page in SITE.rglob("*.html"):
            finish(page)
        print(f"open {SITE.relative_to(ROOT)}/index.html")
    return status


if __name__ == "__main__":
    sys.exit(build())
