"""What a scan of a directory finds, and what it puts aside with which reason."""

import errno
import os
import random
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from vtrack_batch.archive import exif, walk
from vtrack_batch.archive.names import escape, unescape
from vtrack_batch.archive.params import ArchiveParams
from vtrack_batch.archive.read import content_hash, read_bytes
from vtrack_batch.archive.scan import Period, scan
from vtrack_batch.archive.sequences import resolve_duplicates, shares_instant, split_sequences
from vtrack_batch.errors import ConfigError, NoArchive, UnusableFrame
from vtrack_batch.model.known import KnownFile

UTC_NAMES = ArchiveParams(time_zone="UTC")


def put(root, *names, content=b"x"):
    for name in names:
        path = root / os.fsdecode(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def look(root, params=UTC_NAMES, **options):
    return scan(root, params, base=root.parent, **options)


def reasons(found):
    return dict(zip(found.quarantine["path"], found.quarantine["reason"], strict=True))


class TestNames:
    def test_files_and_directories_give_frames_and_platforms(self, tmp_path):
        put(
            tmp_path,
            "north/20260517T060000.jpg",
            "north/20260517T060001.JPG",
            "south/20260517T060000.png",
            "20260517T060000.tif",
        )
        files = look(tmp_path).files
        assert files["platform"].tolist() == ["main", "north", "north", "south"]
        assert files["t_utc"].dt.second.tolist() == [0, 0, 1, 0]
        assert str(files["t_utc"].dtype) == "datetime64[us, UTC]"
        assert files["size_bytes"].tolist() == [1] * 4

    def test_one_platform_if_directories_are_none(self, tmp_path):
        put(tmp_path, "06/20260517T060000.jpg", "07/20260517T070000.jpg")
        params = ArchiveParams(time_zone="UTC", platform_from="none")
        assert set(look(tmp_path, params).files["platform"]) == {"main"}

    def test_directories_that_tell_the_time_are_no_platforms(self, tmp_path):
        put(tmp_path, "2026/05/17/060000.jpg", "2026/05/18/060000.jpg")
        found = look(tmp_path, ArchiveParams(pattern="{time:%Y/%m/%d/%H%M%SZ}.jpg".replace("Z}", "}"), time_zone="UTC"))
        assert set(found.files["platform"]) == {"main"}
        assert found.files["t_utc"].dt.day.tolist() == [17, 18]

    def test_order_of_listing_changes_nothing(self, tmp_path, monkeypatch):
        put(tmp_path, *[f"{d}/20260517T0600{s:02d}.jpg" for d in "abc" for s in range(20)], "x.txt", "odd.jpg")
        once = look(tmp_path)
        real = os.scandir

        class Shuffled:
            def __init__(self, path):
                with real(path) as entries:
                    self.entries = list(entries)
                random.Random(len(self.entries)).shuffle(self.entries)

            def __enter__(self):
                return iter(self.entries)

            def __exit__(self, *_):
                return None

        monkeypatch.setattr(walk.os, "scandir", Shuffled)
        again = look(tmp_path)
        pd.testing.assert_frame_equal(once.files, again.files)
        pd.testing.assert_frame_equal(once.quarantine, again.quarantine)

    def test_unmatched_names_are_put_aside_only_if_they_are_images(self, tmp_path):
        put(tmp_path, "20260517T060000.jpg", "20260517T060001.jpg", "preview.jpg", "readme.txt", "20260599T060000.jpg")
        found = look(tmp_path, ArchiveParams(pattern="{time:%Y%m%dT%H%M%S}.jpg", time_zone="UTC"))
        assert reasons(found) == {"20260599T060000.jpg": "time_unreadable", "preview.jpg": "name_not_matched"}
        assert (found.others, found.other_examples) == (1, ("readme.txt",))

    def test_hidden_and_temporary_names_do_not_exist(self, tmp_path):
        stem = "20260517T060001.jpg"
        put(
            tmp_path,
            "20260517T060000.jpg",
            f".{stem}.Xy12Zz",
            f"{stem}~",
            f"{stem}.part",
            f"{stem}.tmp",
            f".thumbs/{stem}",
        )
        found = look(tmp_path)
        assert found.files["path"].tolist() == ["20260517T060000.jpg"]
        assert found.quarantine.empty
        assert found.others == 0

    def test_pattern_that_fits_nothing_says_so(self, tmp_path):
        put(tmp_path, "a.jpg", "b.jpg")
        with pytest.raises(ConfigError, match=r"none of 2 names fits.*e\.g\. a\.jpg"):
            look(tmp_path, ArchiveParams(pattern="{time:epoch_s}.jpg"))

    def test_names_without_time_say_what_to_write(self, tmp_path):
        put(tmp_path, "001.png", "002.png")
        with pytest.raises(ConfigError, match=r"archive\.pattern.*archive\.index.*archive\.exif"):
            look(tmp_path)

    def test_odd_names_are_escaped_and_still_open(self, tmp_path):
        names = [
            b"20260517T060000\xff.jpg",
            b"new\nline_20260517T060001.jpg",
            b"\x1b[31m_20260517T060002.jpg",
            b"caf\xc3\xa9_20260517T060003.jpg",
        ]
        put(tmp_path, *names, content=b"pixels")
        files = look(tmp_path).files.set_index("path")
        assert sorted(files.index) == sorted(
            [
                "20260517T060000\\xff.jpg",
                "new\\u000aline_20260517T060001.jpg",
                "\\u001b[31m_20260517T060002.jpg",
                "café_20260517T060003.jpg",
            ]
        )
        assert sorted(os.fsencode(unescape(path)) for path in files.index) == sorted(names)
        assert {read_bytes(tmp_path, path) for path in files.index} == {b"pixels"}

    def test_escaping_never_makes_two_names_one(self):
        names = ["a\nb", "a\\u000ab", "a\\nb", "a\udcffb", "a\\xffb", "aÿb"]
        assert len({escape(name) for name in names}) == len(names)
        assert all(escape(name).isprintable() for name in names)
        assert [unescape(escape(name)) for name in names] == names

    @given(st.binary())
    def test_escaping_leads_back_to_any_name(self, name):
        text = escape(os.fsdecode(name))
        assert text.isprintable()
        assert text.encode("utf-8").decode("utf-8") == text
        assert os.fsencode(unescape(text)) == name


class TestTimes:
    def test_stamps_without_zone_are_never_guessed(self, tmp_path):
        put(tmp_path, "20260517T060000.jpg")
        with pytest.raises(ConfigError, match=r"archive\.time_zone.*20260517T060000\.jpg"):
            look(tmp_path, ArchiveParams(), time_zone="Europe/Berlin")

    def test_local_means_the_survey_zone(self, tmp_path):
        put(tmp_path, "20260517T060000.jpg")
        params = ArchiveParams(time_zone="local")
        assert look(tmp_path, params, time_zone="Europe/Berlin").files["t_utc"].dt.hour.tolist() == [4]
        with pytest.raises(ConfigError, match=r"survey\.time_zone"):
            look(tmp_path, params)

    def test_a_zone_in_the_name_is_enough(self, tmp_path):
        put(tmp_path, "20260517T060000Z.jpg")
        assert look(tmp_path, ArchiveParams()).files["t_utc"].dt.hour.tolist() == [6]

    def test_both_nights_of_summer_time_reach_the_quarantine(self, tmp_path):
        put(tmp_path, "20260329T023000.jpg", "20261025T023000.jpg", "20260517T060000.jpg")
        found = look(tmp_path, ArchiveParams(time_zone="Europe/Berlin"))
        assert reasons(found) == {"20260329T023000.jpg": "nonexistent_time", "20261025T023000.jpg": "ambiguous_time"}
        assert len(found.files) == 1

    def test_frames_outside_the_survey(self, tmp_path):
        put(tmp_path, "19700101T000000.jpg", "20260517T060000.jpg", "20260517T070000.jpg")
        bounds = Period(pd.Timestamp("2026-05-17T06:00Z"), pd.Timestamp("2026-05-17T07:00Z"))
        found = look(tmp_path, period=bounds)
        assert found.files["path"].tolist() == ["20260517T060000.jpg"]
        assert set(reasons(found).values()) == {"time_out_of_range"}

    def test_files_too_young_wait(self, tmp_path):
        put(tmp_path, "20260517T060000.jpg", "20260517T060001.jpg")
        os.utime(tmp_path / "20260517T060000.jpg", (1, 1))
        found = look(tmp_path, ArchiveParams(time_zone="UTC", settle_s=3600))
        assert found.files["path"].tolist() == ["20260517T060000.jpg"]
        assert found.pending == ("20260517T060001.jpg",)


class TestIndex:
    def write(self, root, text):
        put(root, "frames/001.png", "frames/002.png", "frames/b/003.png")
        (root / "times.csv").write_text(text, encoding="utf-8")
        return scan(root / "frames", ArchiveParams(index="times.csv", time_zone="UTC"), base=root)

    @pytest.mark.parametrize("separator", [",", ";", "\t"])
    def test_times_and_platforms(self, tmp_path, separator):
        lines = [
            "\ufeffTime,File,camera",
            "2026-05-17T08:00:00+02:00,002.png,a",
            "1779000000.5,b/003.png,",
            "2026-05-17 06:00:00.25,./001.png,b",
        ]
        files = self.write(tmp_path, "\r\n".join(lines).replace(",", separator)).files
        assert files["path"].tolist() == ["001.png", "002.png", "b/003.png"]
        assert files["platform"].tolist() == ["b", "a", "b"]
        assert [str(t)[11:] for t in files["t_utc"]] == [
            "06:00:00.250000+00:00",
            "06:00:00+00:00",
            "06:40:00.500000+00:00",
        ]

    def test_lines_and_files_that_do_not_fit_together(self, tmp_path):
        found = self.write(
            tmp_path,
            "file,time\n001.png,2026-05-17T06:00:00Z\n001.png,2026-05-17T06:00:01Z\n002.png,soon\n../../etc/passwd,2026-05-17T06:00:00Z\n",
        )
        assert reasons(found) == {
            "001.png": "index_contradicts",
            "002.png": "time_unreadable",
            "b/003.png": "not_in_index",
            "../../etc/passwd": "file_missing",
        }
        assert found.files.empty

    @pytest.mark.parametrize("text", ["", "001.png,2026-05-17T06:00:00Z\n", "file;when\n"])
    def test_header_is_needed(self, tmp_path, text):
        with pytest.raises(ConfigError, match="columns file and time"):
            self.write(tmp_path, text)

    def test_missing_index(self, tmp_path):
        put(tmp_path, "a.jpg")
        with pytest.raises(ConfigError, match="does not exist"):
            look(tmp_path, ArchiveParams(index="times.csv"))

    def test_index_of_another_archive(self, tmp_path):
        with pytest.raises(ConfigError, match="none of the 1 files"):
            self.write(tmp_path, "file,time\nf0001.jpg,2026-05-17T06:00:00Z\n")


class TestExif:
    def photograph(self, path, taken="2026:05:17 06:00:01", fraction=None, offset=None):
        tags = Image.Exif()
        inner = {key: value for key, value in {0x9003: taken, 0x9291: fraction, 0x9011: offset}.items() if value}
        if inner:
            tags.get_ifd(0x8769).update(inner)
            tags[0x8769] = inner
        Image.new("RGB", (8, 6)).save(path, exif=tags)

    def test_times_with_fraction_and_offset(self, tmp_path):
        self.photograph(tmp_path / "a.jpg", fraction="25", offset="+02:00")
        self.photograph(tmp_path / "b.jpg")
        files = look(tmp_path, ArchiveParams(exif=True, time_zone="UTC")).files
        assert [str(t)[11:] for t in files["t_utc"]] == ["04:00:01.250000+00:00", "06:00:01+00:00"]

    def test_frames_without_time(self, tmp_path):
        self.photograph(tmp_path / "a.jpg")
        self.photograph(tmp_path / "b.jpg", taken=None)
        self.photograph(tmp_path / "c.jpg", taken="0000:00:00 00:00:00")
        put(tmp_path, "d.jpg", content=b"<html>")
        found = look(tmp_path, ArchiveParams(exif=True, time_zone="UTC"))
        assert reasons(found) == {"b.jpg": "no_exif_time", "c.jpg": "time_unreadable", "d.jpg": "not_an_image"}

    def test_known_files_are_not_opened_again(self, tmp_path, monkeypatch):
        self.photograph(tmp_path / "a.jpg", offset="+02:00")
        params = ArchiveParams(exif=True)
        first = look(tmp_path, params).files.iloc[0]
        known = {"a.jpg": KnownFile(first["size_bytes"], first["mtime_ns"], "abc", first["stamp"])}
        monkeypatch.setattr(exif.Image, "open", None)
        again = look(tmp_path, params, known=known).files.iloc[0]
        assert again["t_utc"] == first["t_utc"]
        assert again["sha256"] == "abc"


class TestArchiveItself:
    def test_missing(self, tmp_path):
        with pytest.raises(NoArchive, match="does not exist"):
            look(tmp_path / "nowhere")

    def test_a_file_is_no_archive(self, tmp_path):
        put(tmp_path, "a")
        with pytest.raises(NoArchive, match="not a directory"):
            look(tmp_path / "a")

    def test_empty(self, tmp_path):
        with pytest.raises(NoArchive, match="holds no frame"):
            look(tmp_path)
        put(tmp_path, "notes.txt")
        with pytest.raises(NoArchive, match=r"1 other files, such as notes\.txt"):
            look(tmp_path)

    def test_empty_where_frames_are_known_asks_for_the_mount(self, tmp_path):
        known = {f"{n}.jpg": KnownFile(1, 1) for n in range(7)}
        with pytest.raises(NoArchive, match="0 of 7 known frames found; is it mounted"):
            look(tmp_path, known=known)

    def test_names_that_look_alike_are_two_files(self, tmp_path):
        """Fault 58: names are the bytes found; what a file system does not fold is not folded here."""
        names = [f"{folder}/20260517T060000.jpg" for folder in ("caf\u00e9", "cafe\u0301", "CAFE")]
        for name in names:
            put(tmp_path, name, content=name.encode())
        files = look(tmp_path).files
        found = {content_hash(read_bytes(tmp_path, path)) for path in files["path"]}
        kept = {content_hash(path.read_bytes()) for path in tmp_path.rglob("*.jpg")}
        assert found == kept
        assert files["platform"].nunique() == len(files) == len(kept)
        assert resolve_duplicates(files.assign(sha256="one"))[1].empty

    def test_links_and_pipes_are_not_followed(self, tmp_path):
        put(tmp_path, "a/20260517T060000.jpg")
        (tmp_path / "a" / "loop").symlink_to(tmp_path / "a")
        (tmp_path / "20260517T060001.jpg").symlink_to(tmp_path / "a" / "20260517T060000.jpg")
        os.mkfifo(tmp_path / "20260517T060002.jpg")
        found = look(tmp_path)
        assert found.files["path"].tolist() == ["a/20260517T060000.jpg"]
        assert reasons(found) == dict.fromkeys(
            ["20260517T060001.jpg", "20260517T060002.jpg", "a/loop"], "not_a_regular_file"
        )

    def test_directory_that_cannot_be_read(self, tmp_path, monkeypatch):
        put(tmp_path, "a/20260517T060000.jpg", "b/20260517T060000.jpg")
        real = os.scandir

        def refuse(path):
            if Path(path).name == "b":
                raise PermissionError(13, "Permission denied")
            return real(path)

        monkeypatch.setattr(walk.os, "scandir", refuse)
        found = look(tmp_path)
        assert found.files["path"].tolist() == ["a/20260517T060000.jpg"]
        assert reasons(found) == {"b": "permission"}


class TestRead:
    def test_bytes_and_their_hash(self, tmp_path):
        put(tmp_path, "a/b.jpg", content=b"abc")
        data = read_bytes(tmp_path, "a/b.jpg")
        assert content_hash(data) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"

    @pytest.mark.parametrize(
        ("name", "reason"),
        [
            ("nothing.jpg", "file_missing"),
            ("link.jpg", "not_a_regular_file"),
            ("pipe.jpg", "not_a_regular_file"),
            ("folder", "not_a_regular_file"),
            ("../outside.jpg", "outside_archive"),
            ("/etc/passwd", "outside_archive"),
            ("\\u002e\\u002e/outside.jpg", "outside_archive"),
            ("nul\\u0000.jpg", "outside_archive"),
            ("large.jpg", "too_large"),
        ],
    )
    def test_refusals(self, tmp_path, name, reason):
        put(tmp_path, "large.jpg", content=bytes(200))
        (tmp_path / "link.jpg").symlink_to("large.jpg")
        os.mkfifo(tmp_path / "pipe.jpg")
        (tmp_path / "folder").mkdir()
        with pytest.raises(UnusableFrame) as caught:
            read_bytes(tmp_path, name, max_bytes=100)
        assert caught.value.reason == reason

    def test_a_file_still_being_written(self, tmp_path, monkeypatch):
        put(tmp_path, "a.jpg", content=b"first half")
        real = os.fstat
        calls = []

        def growing(descriptor):
            calls.append(descriptor)
            if len(calls) == 3:
                with (tmp_path / "a.jpg").open("ab") as file:
                    file.write(b" second half")
            return real(descriptor)

        monkeypatch.setattr("vtrack_batch.archive.read.os.fstat", growing)
        with pytest.raises(UnusableFrame, match="changed_while_reading"):
            read_bytes(tmp_path, "a.jpg")

    @pytest.mark.parametrize("code", [errno.EIO, errno.ESTALE])
    def test_read_errors_are_retried(self, tmp_path, monkeypatch, code):
        """Faults 42 and 48."""
        put(tmp_path, "a.jpg")
        monkeypatch.setattr("vtrack_batch.archive.read.time.sleep", lambda _: None)
        real, failures = os.open, [OSError(code, os.strerror(code))]

        def flaky(*arguments):
            if failures:
                raise failures.pop()
            return real(*arguments)

        monkeypatch.setattr("vtrack_batch.archive.read.os.open", flaky)
        assert read_bytes(tmp_path, "a.jpg") == b"x"
        failures += [OSError(code, os.strerror(code))] * 3
        with pytest.raises(UnusableFrame, match="io_error"):
            read_bytes(tmp_path, "a.jpg")


def table(*rows):
    """Files from (path, platform, ISO time, hash)."""
    files = pd.DataFrame(rows, columns=["path", "platform", "t_utc", "sha256"])
    t_utc = pd.to_datetime(files["t_utc"], utc=True, format="ISO8601").astype("datetime64[us, UTC]")
    return files.assign(name=files["path"], t_utc=t_utc)


class TestDuplicates:
    FILES = table(
        ("a/1", "a", "2026-05-17T06:00:00Z", "x"),
        ("a/2", "a", "2026-05-17T06:00:00Z", "x"),
        ("a/3", "a", "2026-05-17T06:00:00Z", "y"),
        ("a/4", "a", "2026-05-17T06:00:01Z", "x"),
        ("b/1", "b", "2026-05-17T06:00:00Z", "x"),
        ("c/1", "c", "2026-05-17T06:00:00Z", None),
        ("c/2", "c", "2026-05-17T06:00:00Z", None),
    )

    def test_first_by_name_is_kept(self):
        kept, dropped = resolve_duplicates(self.FILES)
        assert kept["path"].tolist() == ["a/1", "a/4", "b/1", "c/1"]
        assert list(dropped[["path", "reason"]].itertuples(index=False, name=None)) == [
            ("a/2", "duplicate_content"),
            ("a/3", "duplicate_time"),
            ("c/2", "duplicate_time"),
        ]
        assert dropped["detail"].tolist() == [
            "the same instant as a/1",
            "the same instant as a/1",
            "the same instant as c/1",
        ]

    def test_any_order_of_rows(self):
        for seed in range(5):
            kept, dropped = resolve_duplicates(self.FILES.sample(frac=1, random_state=seed))
            assert sorted(kept["path"]) == ["a/1", "a/4", "b/1", "c/1"]
            assert dropped["path"].tolist() == ["a/2", "a/3", "c/2"]

    def test_who_shares_an_instant(self):
        assert shares_instant(self.FILES).tolist() == [True, True, True, False, False, True, True]

    def test_none(self):
        kept, dropped = resolve_duplicates(self.FILES.iloc[:0])
        assert len(kept) == len(dropped) == 0


class TestSequences:
    def split(self, *times, platform="a", zone="UTC", gap=30.0):
        files = table(*[(f"{platform}/{n:03d}", platform, text, None) for n, text in enumerate(times)])
        return split_sequences(files, max_gap_s=gap, time_zone=zone)

    def test_a_gap_splits(self):
        found = self.split("2026-05-17T06:00:00.5Z", "2026-05-17T06:00:30.5Z", "2026-05-17T06:01:00.6Z")
        assert found["sequence"].tolist() == ["a/20260517T060000Z", "a/20260517T060000Z", "a/20260517T060100Z"]

    def test_local_midnight_splits_and_utc_midnight_does_not(self):
        found = self.split(
            "2026-05-17T21:59:59Z", "2026-05-17T22:00:00Z", "2026-05-17T23:59:59Z", "2026-05-18T00:00:00Z",
            zone="Europe/Berlin", gap=9000,
        )  # fmt: skip
        assert found["sequence"].tolist() == ["a/20260517T215959Z"] + ["a/20260517T220000Z"] * 3
        assert found["date"].tolist() == ["2026-05-17"] + ["2026-05-18"] * 3

    def test_platforms_do_not_mix_and_order_does_not_matter(self):
        files = table(*[(f"{p}/{s:02d}", p, f"2026-05-17T06:00:{s:02d}Z", None) for s in range(20) for p in "ab"])
        once = split_sequences(files, max_gap_s=30, time_zone=None)
        again = split_sequences(files.sample(frac=1, random_state=1), max_gap_s=30, time_zone=None)
        pd.testing.assert_frame_equal(once, again)
        assert once.groupby("platform")["sequence"].unique().map(list).to_dict() == {
            "a": ["a/20260517T060000Z"],
            "b": ["b/20260517T060000Z"],
        }

    def test_one_and_none(self):
        assert self.split("2026-05-17T06:00:00Z")["sequence"].tolist() == ["a/20260517T060000Z"]
        assert self.split().columns.tolist()[-2:] == ["sequence", "date"]

    def test_names_are_unique_even_at_the_shortest_gap(self):
        rng = np.random.default_rng(2)
        t = pd.Timestamp("2026-05-17T06:00:00Z") + pd.to_timedelta(np.cumsum(rng.uniform(0.5, 1.6, 300)), unit="s")
        found = self.split(*[each.isoformat() for each in t], gap=1.0)
        begins = found["t_utc"].diff().dt.total_seconds() > 1.0
        assert found["sequence"].nunique() == begins.sum() + 1


@pytest.mark.real
def test_real_frames_with_an_index(shared_data):
    base = shared_data / "kit-ais" / "MunichStreet02"
    found = scan(base / "frames", ArchiveParams(index="times.csv"), base=base)
    assert len(found.files) == 20
    assert found.quarantine.empty
    assert (found.files["t_utc"].diff().dropna() == pd.Timedelta("500ms")).all()


def test_a_deep_and_wide_tree_is_walked_in_order(tmp_path):
    """Fault 60: one folder's names at a time, in the order of whole paths, however deep."""
    place = tmp_path
    for _ in range(300):
        place = place / "d"
        place.mkdir()
    (place / "last.jpg").write_bytes(b"x")
    put(tmp_path, "a/b.jpg", "a-b.jpg", "a.jpg", "a/c/d.jpg", "b.jpg", *(f"w/{n:04d}.jpg" for n in range(500)))
    names = [found.name for found in walk.walk(tmp_path)]
    assert names == sorted(names, key=os.fsencode)
    assert len(names) == 506
    assert walk.listing_of(tmp_path) is None, "just written"
    for path in tmp_path.rglob("*.jpg"):
        os.utime(path, (1e9, 1e9))
    once = walk.listing_of(tmp_path)
    assert once == walk.listing_of(tmp_path)
    os.utime(tmp_path / "b.jpg", (1e9 + 1, 1e9 + 1))
    assert walk.listing_of(tmp_path) != once
