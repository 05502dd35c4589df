"""Functions that run a user's Python file, and find the classes in it that extend swimid."""

from __future__ import annotations

import importlib.util
import inspect
import sys
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

from swimid import reading
from swimid.errors import InputError


def run_file(path: Path, what: str) -> ModuleType:
    """Run a user's Python file, and return it as a module.

    Parameters
    ----------
    path : Path
    what : str
        Plural noun for the objects that the file defines, such as ``"effects"``, for messages.

    Raises
    ------
    InputError
        If there is no such file, or if it cannot be run. The error states file and line.
    """
    if not path.is_file():
        raise InputError("there is no such file", file=path, hint="check the path")
    name = f"swimid_{what}_of_{path.stem}_{abs(hash(path.resolve()))}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InputError("is no Python file", file=path, hint=f"{what} are classes in a file ending in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    reading.note(path)
    try:
        with reading.watch():
            spec.loader.exec_module(module)
    except SyntaxError as error:
        raise InputError(f"is no valid Python: {error.msg}", file=path, line=error.lineno) from error
    except Exception as error:
        problem = f"cannot be run: {type(error).__name__}: {error}"
        raise InputError(problem, file=path, line=last_line(error, path)) from error
    return module


def last_line(error: Exception, path: Path) -> int | None:
    """Return the last line number in the given file that the traceback of an error contains, or None."""
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
    return lines[-1] if lines else None


def find_classes(module: ModuleType, base: Any) -> list[Any]:
    """Return the public subclasses of a class that a module defines, in the order of definition."""
    return [
        kind
        for name, kind in vars(module).items()
        if inspect.isclass(kind)
        and issubclass(kind, base)
        and kind.__module__ == module.__name__
        and not name.startswith("_")
    ]
