"""Templates of pages, scripts and models, which lie in the folders ``templates`` of the packages."""

from __future__ import annotations

from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined


def environment(package: str, **options: Any) -> Environment:
    """Return the jinja2 environment of a package's templates. An undefined template variable is an error.

    Parameters
    ----------
    package : str
        Name of the package, such as ``swimid.runs``.
    **options
        Further arguments of :class:`jinja2.Environment`.
    """
    loader = PackageLoader(package)
    return Environment(loader=loader, undefined=StrictUndefined, trim_blocks=True, **options)
