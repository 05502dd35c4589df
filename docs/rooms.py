"""The rooms of the package, counted: modules, lines, imports between rooms, cycles.

    python docs/rooms.py            every room, the lowest first
    python docs/rooms.py rig        one room: its modules, what they import, who imports them

A room is a folder of ``swimid/``. Nothing of swimid is imported: the files are read as text. An import
counts wherever it stands, inside a function too; one that only types need (``if TYPE_CHECKING``) does not.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "swimid"
Graph = dict[str, set[str]]


def modules(package: Path = PACKAGE) -> dict[str, Path]:
    """Every module by its dotted name below the package (``rig.model``), a room by its own (``rig``)."""
    found = {}
    for path in sorted(package.rglob("*.py")):
        if "__pycache__" in path.parts:
            continue  # generated kernels
        parts = path.relative_to(package).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def rooms(package: Path = PACKAGE) -> list[str]:
    """The rooms by name."""
    return sorted(path.parent.name for path in package.glob("*/__init__.py"))


def room(module: str) -> str:
    """The room a module lies in; its own name where it lies beside them."""
    return module.split(".")[0]


def imports(package: Path = PACKAGE) -> Graph:
    """By module, the modules of the package that it imports."""
    known = modules(package)
    found = {}
    for name, path in known.items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        own = {name.rsplit(".", up)[0] for up in range(name.count(".") + 1)}  # a module rests on its folders
        found[name] = set(_imported(tree, known, package.name)) - own - {""}
    return found


def _imported(node: ast.AST, known: dict[str, Path], package: str) -> Iterator[str]:
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        return
    for child in ast.iter_child_nodes(node):
        yield from _imported(child, known, package)
    whole = []
    if isinstance(node, ast.Import):
        whole = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom) and node.module:
        whole = [f"{node.module}.{alias.name}" for alias in node.names]
        # a name that is no module of its own is one in the module before it
        whole = [name if _below(name, package) in known else node.module for name in whole]
    yield from (_below(name, package) for name in whole if _below(name, package) in known)


def _below(name: str, package: str) -> str:
    return name.removeprefix(f"{package}.") if name.startswith(f"{package}.") else "-"


def between_rooms(graph: Graph, names: list[str]) -> dict[str, Counter[str]]:
    """By room, the other rooms it imports from, and by how many imports of a module by a module."""
    found: dict[str, Counter[str]] = {name: Counter() for name in names}
    for module, others in graph.items():
        if room(module) in found:
            mine = found[room(module)]
            mine.update(room(o) for o in others if room(o) in found and room(o) != room(module))
    return found


def cycle(graph: Graph) -> list[str]:
    """One cycle of who imports whom; empty where there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def lines(path: Path) -> int:
    """Lines of a file."""
    return len(path.read_text(encoding="utf-8").splitlines())


def overview() -> str:
    """A line for each room, and what goes round in circles."""
    graph, known = imports(), modules()
    arrows = between_rooms(graph, rooms())
    circle = cycle({name: set(others) for name, others in arrows.items()})
    order = rooms() if circle else list(TopologicalSorter(arrows).static_order())
    said = [f"{'room':<12}{'modules':>8}{'lines':>8}  imports from (how often)"]
    for name in order:
        paths = [path for module, path in known.items() if room(module) == name]
        others = ", ".join(f"{o} {arrows[name][o]}" for o in order if o in arrows[name])
        said.append(f"{name:<12}{len(paths):>8}{sum(map(lines, paths)):>8}  {others or 'no other room'}")
    beside = [path for module, path in known.items() if room(module) not in order]
    said.append(f"{'beside them':<12}{len(beside):>8}{sum(map(lines, beside)):>8}")
    said.append(f"{'all':<12}{len(known):>8}{sum(map(lines, known.values())):>8}")
    said.append(f"arrows between rooms: {sum(map(len, arrows.values()))}")
    said.append(f"cycles between rooms: {' -> '.join(circle) or 'none'}")
    said.append(f"cycles between modules: {' -> '.join(cycle(graph)) or 'none'}")
    return "\n".join(said)


def one(name: str) -> str:
    """The modules of a room: lines, what of other rooms they import, who of other rooms imports them."""
    graph, inside = imports(), {name, ""}
    said = []
    for module, path in modules().items():
        if room(module) != name:
            continue
        said.append(f"{module}, {lines(path)} lines")
        used = sorted(other for other in graph[module] if room(other) not in inside)
        users = sorted(other for other in graph if module in graph[other] and room(other) not in inside)
        said += [f"    imports {', '.join(used)}"] if used else []
        said += [f"    imported by {', '.join(users)}"] if users else []
    return "\n".join(said)


def main(arguments: list[str]) -> int:
    """Print every room, or the one that is named."""
    if not arguments:
        print(overview())
        return 0
    if arguments[0] not in rooms():
        print(f"there is no room '{arguments[0]}'; there are: {', '.join(rooms())}", file=sys.stderr)
        return 2
    print(one(arguments[0]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
