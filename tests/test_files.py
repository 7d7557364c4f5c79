"""Files appear whole or not at all, under names that fit, and never through somebody else's link."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from atlas import BadInput, files
from atlas.errors import failure_text
from atlas.files import atomic_write, remove_leftovers


def test_a_folder_that_is_gone_is_named_in_words(tmp_path):
    """The error names a temporary file in it."""
    for path, text in (
        (
            tmp_path / "tiles" / ".x.tmp",
            f"{tmp_path / 'tiles'}: this folder is not there any more: it was removed",
        ),
        (tmp_path / "a.nc", "[Errno 2] No such file or directory"),
    ):
        with pytest.raises(FileNotFoundError) as error:
            path.read_bytes()
        assert failure_text(error.value).startswith(text)
    assert failure_text(MemoryError()) == "MemoryError"


def test_a_file_is_flushed_before_it_is_moved_and_its_folder_after(tmp_path, monkeypatch):
    order, fsync, replace = [], os.fsync, os.replace

    def noted_fsync(handle):
        order.append(os.fstat(handle).st_ino)
        fsync(handle)

    def noted_replace(source, target):
        order.append("moved")
        replace(source, target)

    monkeypatch.setattr(files.os, "fsync", noted_fsync)
    monkeypatch.setattr(files.os, "replace", noted_replace)
    with atomic_write(tmp_path / "a") as temporary:
        temporary.write_text("whole")
    assert order == [(tmp_path / "a").stat().st_ino, "moved", tmp_path.stat().st_ino]


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path):
    (tmp_path / "a").write_text("old")

    def write_half():
        with atomic_write(tmp_path / "a") as temporary:
            temporary.write_text("new, but")
            raise ValueError("stop")

    with pytest.raises(ValueError, match="stop"):
        write_half()
    assert [p.name for p in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_text() == "old"


def test_the_name_may_be_as_long_as_the_file_system_allows(tmp_path):
    longest = os.pathconf(tmp_path, "PC_NAME_MAX")
    with atomic_write(tmp_path / ("a" * longest)) as temporary:
        temporary.write_text("whole")
    assert (tmp_path / ("a" * longest)).read_text() == "whole"
    with pytest.raises(BadInput, match="too long") as error:
        files.writable(tmp_path / ("a" * longest + ".nc"), (".nc",), force=False)
    assert "\n" not in str(error.value)


def test_a_planted_link_is_not_followed(tmp_path, monkeypatch):
    monkeypatch.setattr(files.secrets, "token_hex", lambda count: "0" * 2 * count)
    victim = tmp_path / "victim"
    victim.write_text("kept")
    (tmp_path / f".atlas-{files.process_name()}-00000000.tmp").symlink_to(victim)
    with pytest.raises(FileExistsError), atomic_write(tmp_path / "a") as temporary:
        temporary.write_text("overwritten")
    assert victim.read_text() == "kept"


@pytest.fixture
def other_process():
    """A process that waits, and its name."""
    code = "import sys; from atlas import files; print(files.process_name(), flush=True); sys.stdin.read()"
    other = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    name = other.stdout.readline().strip()
    yield other, name
    other.kill()
    other.communicate()


def test_a_process_is_found_to_run_until_it_is_killed(other_process):
    other, name = other_process
    assert files.is_running(name) is True
    other.kill()
    os.waitid(os.P_PID, other.pid, os.WEXITED | os.WNOWAIT)  # it has ended, its exit status is not asked for
    assert files.is_running(name) is False
    other.wait()
    assert files.is_running(name) is False


@pytest.mark.long
def test_leftovers_of_killed_processes_are_removed_and_all_else_is_kept(tmp_path, other_process, monkeypatch):
    other, name = other_process
    machine, rest = name.split("-", 1)
    foreign = f"{int(machine, 16) ^ 1:08x}-{rest}"
    names = [f".atlas-{n}-0123abcd.tmp" for n in (name, foreign)] + ["mine.tmp", ".atlas-thesis.tmp"]
    for each in names:
        (tmp_path / each).write_text("content")
    remove_leftovers(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names)
    other.kill()
    other.wait()
    remove_leftovers(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names[1:])
    week_ago = (tmp_path / "mine.tmp").stat().st_mtime - files.FOREIGN_LEFTOVER_AGE
    os.utime(tmp_path / names[1], (week_ago + 100, week_ago + 100))
    remove_leftovers(tmp_path)
    assert (tmp_path / names[1]).exists()
    os.utime(tmp_path / names[1], (week_ago - 1, week_ago - 1))
    remove_leftovers(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names[2:])
    remove_leftovers(tmp_path / "no such folder")


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    """After an error what was there stays, and nothing else is left, nor from a process that was killed."""
    path = tmp_path / "store"
    machine, boot, _, _ = files.process_name().split("-")
    (tmp_path / f".atlas-{machine}-{boot}-1-1-00000000.tmp").mkdir()
    for content in ("first", "second"):
        with files.atomic_folder(path) as temporary:
            assert files.TEMPORARY.fullmatch(temporary.name)
            (temporary / "inner").mkdir()
            (temporary / "inner" / "file").write_text(content)
        assert (path / "inner" / "file").read_text() == content

    def write_half():
        with files.atomic_folder(path) as temporary:
            (temporary / "other").write_text("unfinished")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    with pytest.MonkeyPatch.context() as patch:
        rename = os.rename

        def fail(source, target):
            if target == path and (source / "third").exists():
                raise OSError("full")
            rename(source, target)

        patch.setattr(os, "rename", fail)
        with pytest.raises(OSError, match="full"), files.atomic_folder(path) as temporary:
            (temporary / "third").write_text("third")
    assert [entry.name for entry in tmp_path.iterdir()] == ["store"]
    assert [entry.name for entry in path.iterdir()] == ["inner"]


def test_a_name_made_of_that_of_an_atlas_is_one_in_this_folder_where_that_is_an_address():
    cases = {
        "a/k3_0.5.nc": "a/k3_0.5",
        "k3_0.5/": "k3_0.5",
        "s3://bucket/night.zarr": "night",
        "s3://bucket/a/night/": "night",
    }
    for name, stem in cases.items():
        assert files.without_suffix(name, ".nc", ".zarr") == Path(stem)
