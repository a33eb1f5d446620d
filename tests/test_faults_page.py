"""docs/reliability.md names a test for every fault of the catalogue, and each test that it names is there."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

from vtrack_batch.pipeline.doctor import examine

PROJECT = Path(__file__).resolve().parents[1]
PAGE = (PROJECT / "docs" / "reliability.md").read_text(encoding="utf-8")
FAULTS = range(1, 84)
COME_LATER = {75, 80}
MOST_WITHOUT = 8
FORBIDDEN = {"pickle", "joblib", "dill", "marshal", "shelve", "yaml"}


def rows(text: str) -> dict[int, str]:
    return {int(number): rest for number, rest in re.findall(r"^\| (\d+) \| (.*) \|$", text, re.MULTILINE)}


def test_every_fault_has_a_test_or_a_reason() -> None:
    with_test, without = (rows(part) for part in PAGE.split("## Without a test"))
    assert not set(with_test) & set(without)
    assert set(with_test) | set(without) == set(FAULTS)
    assert len(set(without) - COME_LATER) <= MOST_WITHOUT
    assert all("`test_" in text for text in with_test.values())


def test_every_test_that_is_named_is_there() -> None:
    source = "\n".join(path.read_text(encoding="utf-8") for path in (PROJECT / "tests").rglob("test_*.py"))
    there = set(re.findall(r"def (test_\w+)", source))
    named = set(re.findall(r"`(test_\w+)`", PAGE))
    assert not named - there


def test_decoders_are_bounded_below_pinned_and_shown() -> None:
    """Fault 83: which decoder read a frame is known, and none older than those that were tried can be installed."""
    dependencies = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    pins = (PROJECT / "requirements.lock").read_text(encoding="utf-8")
    shown = next(finding.value for finding in examine(None) if finding.name == "packages")
    for decoder in ("opencv-python-headless", "pillow", "rasterio", "simplejpeg"):
        assert [text for text in dependencies if text.startswith(f"{decoder}>=")], decoder
        assert re.search(rf"^{decoder}==[^\n]*\\\n +--hash=sha256:", pins, re.MULTILINE), decoder
        assert shown[decoder] != "-"


def test_nothing_read_is_executed() -> None:
    """Fault 78: no pickles, no eval; what workers are sent is made by their own run."""
    for path in (PROJECT / "vtrack_batch").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = [alias.name for alias in node.names] + [getattr(node, "module", "") or ""]
                assert not FORBIDDEN & {name.split(".")[0] for name in names}, path
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("eval", "exec", "__import__"), path
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                assert isinstance(node.value, ast.Constant), path
                assert node.value.value is False, path
