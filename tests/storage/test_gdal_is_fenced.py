"""GDAL reads GeoTIFF from memory, and nothing else: no other driver, no other file, no network. Fault 79."""

from __future__ import annotations

import ast
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import rasterio

from vtrack_batch.archive.decode import decode
from vtrack_batch.archive.read import read_bytes
from vtrack_batch.errors import UnusableFrame
from vtrack_batch.storage.geotiff import read_geotags

PACKAGE = Path(__file__).parents[2] / "vtrack_batch"


class Listener:
    """A server that counts who calls, and hangs up."""

    def __init__(self) -> None:
        self.calls = 0
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                caller, _ = self._socket.accept()
            except OSError:
                return
            self.calls += 1
            caller.close()

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def listener() -> Iterator[Listener]:
    found = Listener()
    yield found
    found.close()


def virtual(source: str) -> bytes:
    """A picture of GDAL's own whose pixels are those of *source*."""
    return (
        '<VRTDataset rasterXSize="9" rasterYSize="9"><VRTRasterBand dataType="Byte" band="1"><SimpleSource>'
        f'<SourceFilename relativeToVRT="0">{source}</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    ).encode()


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_pictures_that_lead_elsewhere_are_refused_unopened(listener: Listener, tmp_path: Path) -> None:
    data = virtual(f"/vsicurl/http://127.0.0.1:{listener.port}/elsewhere.tif")
    for read in (lambda: decode(data, max_pixels=10**6), lambda: read_geotags(data)):
        with pytest.raises(UnusableFrame) as caught:
            read()
        assert caught.value.reason in ("not_an_image", "malformed")
    for name in (f"/vsicurl/http://127.0.0.1:{listener.port}/a.tif", "/vsizip/a.zip/a.tif", "/vsimem/a.tif"):
        with pytest.raises(UnusableFrame, match="outside_archive"):
            read_bytes(tmp_path, name)
    assert listener.calls == 0
    # the same picture, opened as GDAL would by itself, does call
    (tmp_path / "a.vrt").write_bytes(data)
    with rasterio.open(tmp_path / "a.vrt") as picture, pytest.raises(rasterio.errors.RasterioError):
        picture.read()
    assert listener.calls > 0


def test_every_picture_is_opened_by_the_one_driver() -> None:
    """But for that of a scenario, which its author chose."""
    opened = []
    for path in PACKAGE.rglob("*.py"):
        calls = (node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call))
        for call in calls:
            if path.parent.name != "simulation" and ast.unparse(call.func) in ("rasterio.open", "memory.open"):
                opened.append([ast.unparse(each.value) for each in call.keywords if each.arg == "driver"])
    assert len(opened) >= 5
    assert opened == [["'GTiff'"]] * len(opened)
