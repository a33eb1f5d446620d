"""The folders tell the story: who may import whom, which library lives where, what starts fast, how long a file is."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "vtrack_batch"
FILES = {str(path.relative_to(PACKAGE)): path for path in sorted(PACKAGE.rglob("*.py"))}
MOST_LINES = 400

CHAPTERS = {
    "archive", "georeference", "registration", "background", "detection", "matching",
    "completeness", "tracking", "revision", "traffic", "evaluation", "simulation", "report",
}  # fmt: skip
NOUNS = {"model", "errors"}
BELOW_PIPELINE = {"config", "storage", *CHAPTERS, *NOUNS}

# folder (or file) -> what of the package it may import besides itself; `chapter.params` = that file only
MAY_IMPORT = {
    "errors": set(),
    "model": {"errors"},
    "storage": NOUNS,
    **dict.fromkeys(CHAPTERS, NOUNS),
    "detection": {"background", *NOUNS},
    "completeness": {"detection", *NOUNS},
    "tracking": {"matching", *NOUNS},
    "simulation": {"traffic.params", *NOUNS},
    "config": {*(f"{chapter}.params" for chapter in CHAPTERS), *NOUNS},
    "pipeline": BELOW_PIPELINE,
    "cli": {"pipeline", *BELOW_PIPELINE},
    "__init__": {"pipeline", *BELOW_PIPELINE},
    "__main__": {"cli"},
}

# library -> the only files that may import it
ONLY_IN = {
    "click": ["cli/*"],
    "pebble": ["pipeline/*"],
    "filelock": ["storage/*"],
    "pyarrow": ["storage/*", "evaluation/load.py", "simulation/write.py"],
    "ruamel": ["config/*", "simulation/write.py"],
    "rasterio": ["storage/geotiff.py", "archive/*", "simulation/write.py"],
    "simplejpeg": ["archive/*", "simulation/write.py"],
    "matplotlib": ["report/*"],
    "sumo": ["simulation/sumo.py"],
    "distributed": ["pipeline/*"],
    "pydantic": ["config/*", "*/params.py", "simulation/view_params.py"],
}

# these files load nothing slow until a command is at work, not even through others
START_FAST = ["cli/*", "__init__.py", "__main__.py", "errors.py", "pipeline/glance.py"]
SLOW = {"numpy", "pandas", "cv2", "pyarrow", "pydantic", "scipy", "numba", "shapely", "rasterio", "matplotlib"}


@cache
def parsed(file: str) -> ast.Module:
    return ast.parse(FILES[file].read_text(encoding="utf-8"))


def imported(file: str, *, at_start: bool = False) -> Iterator[str]:
    """Dotted names that *file* imports; *at_start*: only those that run when it is loaded."""
    nodes: list[ast.AST] = [parsed(file)]
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: imports are written in full"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif at_start and isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        elif at_start and isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            nodes += node.orelse
            continue
        nodes += ast.iter_child_nodes(node)


def own_files(name: str) -> set[str]:
    """The files of the package that importing the dotted *name* loads."""
    parts = name.split(".")[1:] if name.startswith("vtrack_batch") else []
    loaded = ["/".join(parts[:n]) for n in range(1, len(parts) + 1)]
    return {file for stem in loaded for file in (f"{stem}.py", f"{stem}/__init__.py") if file in FILES}


@pytest.mark.parametrize("file", FILES)
def test_imports_go_one_way(file: str) -> None:
    folder = Path(file).parts[0].removesuffix(".py")
    assert folder in MAY_IMPORT, f"{file}: a new folder wants its line in MAY_IMPORT"
    for name in imported(file):
        parts = name.split(".")
        if parts[0] == "vtrack_batch" and len(parts) > 1 and parts[1] != folder and own_files(name):
            allowed = {parts[1], ".".join(parts[1:3])} & MAY_IMPORT[folder]
            assert allowed, f"{file} imports {name}; {folder} may import {sorted(MAY_IMPORT[folder])}"


@pytest.mark.parametrize("library", ONLY_IN)
def test_libraries_stay_behind_their_fences(library: str) -> None:
    users = [file for file in FILES if any(name.split(".")[0] == library for name in imported(file))]
    strangers = [file for file in users if not any(fnmatch(file, home) for home in ONLY_IN[library])]
    assert not strangers, f"{library} belongs to {ONLY_IN[library]}"


@pytest.mark.parametrize("file", [file for file in FILES if any(fnmatch(file, home) for home in START_FAST)])
def test_starting_up_loads_nothing_slow(file: str) -> None:
    seen, waiting = set(), {file}
    while waiting:
        seen.add(current := waiting.pop())
        names = list(imported(current, at_start=True))
        slow = sorted(SLOW & {name.split(".")[0] for name in names})
        assert not slow, f"{file} loads {slow} through {current}: import it inside the function that needs it"
        waiting |= {other for name in names for other in own_files(name)} - seen


@pytest.mark.parametrize("file", FILES)
def test_a_file_holds_one_concept(file: str) -> None:
    lines = FILES[file].read_text(encoding="utf-8").count("\n")
    assert lines <= MOST_LINES, f"{file} has {lines} lines: divide it"
