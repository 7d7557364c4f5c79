"""Files and stores of strangers: no other file is read, no memory is taken without bound, and nothing of theirs is replaced."""

import fcntl
import gzip
import json
import shutil
from pathlib import Path

import h5py
import netCDF4
import numpy as np
import pytest
import xarray as xr

import atlas
from atlas import BadInput, cli
from atlas.store.netcdf import FORMAT
from atlas.store.zarr_store import _root_hash, _unpacked_bytes

pytestmark = pytest.mark.usefixtures("whole_kernels")
SECRET = b"what only the reader may see" * 40


@pytest.fixture(scope="module")
def made(small_scene, tmp_path_factory):
    """A folder with an atlas in both formats, and a file of points."""
    folder = tmp_path_factory.mktemp("made")
    atlas.run(small_scene, folder / "a.nc", progress=False).close()
    atlas.run(small_scene, folder / "a.zarr", progress=False).close()
    xr.Dataset({"m": ("point", np.linspace(0.1, 0.9, 5))}).to_netcdf(folder / "points.nc")
    return folder


@pytest.fixture
def folder(made, tmp_path, monkeypatch):
    """The working folder, a copy of `made` with a secret beside it."""
    shutil.copytree(made, tmp_path / "work")
    monkeypatch.chdir(tmp_path / "work")
    (tmp_path / "secret").write_bytes(SECRET)
    return tmp_path / "work"


def external(file, name):
    shape, kind = file[name].shape, file[name].dtype
    del file[name]
    file.create_dataset(name, shape=shape, dtype=kind, external=[("../secret", 0, h5py.h5f.UNLIMITED)])


def linked(file, name):
    del file[name]
    file[name] = h5py.ExternalLink("../other.nc", "/x")


def virtual(file, name):
    shape, kind = file[name].shape, file[name].dtype
    layout = h5py.VirtualLayout(shape=shape, dtype=kind)
    layout[...] = h5py.VirtualSource("../other.nc", "x", shape=shape)
    del file[name]
    file.create_virtual_dataset(name, layout)


def circular(file, name):
    group = file.create_group("inner")
    group["again"] = group


def bomb(file, name):
    file.create_dataset("more", (4, 4), "f8", maxshape=(None, 4), chunks=(10_000_000, 4), compression="gzip")


def half(file, name):
    file["more"] = np.zeros(3, "f2")


def many(file, name):
    for i in range(2001):
        file.create_group(f"g{i}")


FORMS = {
    external: "the values of {} are in other files", linked: "{} is a link to another file",
    virtual: "the values of {} are in other files", circular: "a group of it has two names, or contains itself",
    bomb: "the chunks of more are larger than the array",
    half: "more has floats of 2 bytes, which the NetCDF library cannot read", many: "it has more than 2000 variables and groups",
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.__name__)
def test_a_file_that_reads_others_or_takes_memory_without_bound_is_refused(form, folder, capsys):
    for path, name, read in (
        ("a.nc", "label", atlas.open_atlas),
        ("points.nc", "m", lambda path: atlas.label_points("satellite", path, duration=1.0)),
    ):
        with h5py.File(path, "r+") as file:
            form(file, name)
        with pytest.raises(BadInput) as error:
            read(path)
        reason = FORMS[form].format(name)
        assert str(error.value) == f"{path}: not a NetCDF file that can be read ({reason})"
    assert cli.main(["status", "a.nc", "--verify"]) == 2
    assert "secret" not in capsys.readouterr().out
    with pytest.raises(BadInput, match=r"^a\.nc: damaged \("):
        FORMAT.verify(Path("a.nc"))


def test_a_link_inside_a_file_is_followed_and_a_changed_file_is_checked_again(folder):
    with h5py.File("a.nc", "r+") as file:
        file["other_name"] = h5py.SoftLink("/label")
    atlas.open_atlas("a.nc").close()
    with h5py.File("a.nc", "r+") as file:
        external(file, "label")
    with pytest.raises(BadInput, match="in other files"):
        atlas.open_atlas("a.nc")


def write(path, content):
    Path(path).write_bytes(content)


def foreign(path):
    with netCDF4.Dataset(path, "w") as file:
        file.createDimension("x", 4)
        file.createVariable("mydata", "f8", ("x",))[:] = 1


@pytest.mark.parametrize("name", ["theirs.nc", "theirs.png", "theirs.csv", "theirs.zarr", "theirs.toml"])
@pytest.mark.parametrize("state", ["whole", "cut", "classic", "locked"])
def test_force_replaces_no_file_of_another_program(name, state, folder, small_scene, capsys):
    foreign("theirs.nc")
    content = Path("theirs.nc").read_bytes()
    if state == "cut":
        content = content[: len(content) // 2]
    elif state == "classic":
        content = b"CDF\x01" + bytes(200)
    Path("theirs.nc").unlink()
    write(name, content)
    Path("small.toml").write_text(small_scene)
    commands = {
        ".nc": [["run", "small.toml"], ["points", "satellite", "points.nc", "--duration", "1"], ["trajectory", "small.toml"]],
        ".png": [["map", "a.nc"]], ".csv": [["points", "satellite", "points.nc", "--duration", "1"]],
        ".zarr": [["run", "small.toml"]], ".toml": [],
    }  # fmt: skip
    with open(name, "rb") as file:
        if state == "locked":
            fcntl.flock(file, fcntl.LOCK_EX)
        for command in commands[Path(name).suffix]:
            assert cli.main([*command, "-o", name, "--force"]) == 2
            message = capsys.readouterr().err
            assert message.startswith(f"atlas: {name}: ")
            assert message.endswith(
                "choose another name\n" if state != "locked" else "; it is not replaced\n"
            )
            assert message.count("\n") == 1
        if name == "theirs.toml":
            with pytest.raises(BadInput, match="not replaced"):
                atlas.files.writable(name, (".toml",), force=True)
    assert Path(name).read_bytes() == content


def test_a_figure_a_table_and_a_text_are_replaced(folder):
    for name in ("map.png", "table.csv", "scene.toml", "page.html"):
        write(name, b"of somebody")
        assert atlas.files.writable(name, (Path(name).suffix,), force=True) == Path(name)


@pytest.mark.long
def test_a_damaged_atlas_is_made_again(folder, small_scene):
    whole = Path("a.nc").read_bytes()
    for damaged in (
        whole[:-100],
        whole.replace(b"atlas_scene", b"atlas\xffscene", 1),
        whole[:200] + bytes(200) + whole[400:],
    ):
        assert damaged != whole
        write("a.nc", damaged)
        with pytest.raises(BadInput, match=r"^a\.nc: this file exists"):
            atlas.run(small_scene, "a.nc", progress=False)
        with atlas.run(small_scene, "a.nc", force=True, progress=False) as ds:
            assert "label" in ds


def test_a_locked_atlas_is_said_to_be_locked(folder, capsys):
    with open("a.nc", "rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert cli.main(["status", "a.nc"]) == 2
        message = capsys.readouterr().err
        assert message == (
            "atlas: a.nc: another program writes it, or has locked it (HDF5_USE_FILE_LOCKING=FALSE reads it all the same)\n"
        )


GZIP, BYTES = {"name": "gzip", "configuration": {"level": 1}}, {"name": "bytes"}


@pytest.mark.parametrize(
    ("codecs", "content", "reason"),
    [
        ([BYTES, GZIP], gzip.compress(bytes(10**7)), "does not unpack to the numbers of its chunk"),
        ([BYTES, GZIP], b"garbage", "does not unpack to the numbers of its chunk"),
        ([BYTES, GZIP], gzip.compress(bytes(3)), "does not unpack to the numbers of its chunk"),
        ([BYTES], bytes(5), "the values of label are damaged: cannot reshape array of size 5"),
        ([BYTES, GZIP, GZIP], gzip.compress(gzip.compress(bytes(9))), r"the codecs of label may unpack to more than its chunks"),
        ([BYTES, {"name": "zstd", "configuration": {"level": 1, "checksum": False}}], b"\x28\xb5\x2f\xfd\xa0\0\0\0\x7f", "does not unpack"),
    ],
    ids=["too large", "garbage", "too small", "plain", "packed twice", "zstd"],
)  # fmt: skip
def test_objects_that_do_not_fit_are_refused_by_name(codecs, content, reason, folder):
    metadata = json.loads(Path("a.zarr/zarr.json").read_text())
    metadata["attributes"].pop("atlas_sha256")
    metadata["consolidated_metadata"]["metadata"]["label"]["codecs"] = codecs
    Path("a.zarr/zarr.json").write_text(json.dumps(metadata))
    write("a.zarr/label/c/0/0", content)
    with pytest.raises(BadInput, match=rf"^a\.zarr: .*{reason}"):
        atlas.open_atlas("a.zarr").label.load()


def test_a_sealed_store_with_other_codecs_or_too_many_arrays_is_refused(folder):
    whole = json.loads(Path("a.zarr/zarr.json").read_text())

    def sealed(change, reason):
        metadata = json.loads(json.dumps(whole))
        change(metadata["consolidated_metadata"]["metadata"])
        metadata["attributes"]["atlas_sha256"] = f"{_root_hash(metadata)}-0"
        Path("a.zarr/zarr.json").write_text(json.dumps(metadata))
        with pytest.raises(BadInput, match=reason):
            atlas.open_atlas("a.zarr")

    sealed(
        lambda arrays: arrays["label"].update(codecs=[BYTES, GZIP, GZIP]),
        r"the codecs of label .*bytes, gzip",
    )
    sealed(
        lambda arrays: arrays.update({f"v{i}": arrays["label"] for i in range(2001)}), "more than 2000 arrays"
    )


def test_a_sealed_store_whose_objects_have_no_checksum_is_damaged(folder):
    metadata = json.loads(Path("a.zarr/zarr.json").read_text())
    metadata["consolidated_metadata"]["metadata"]["label"]["codecs"] = [BYTES, GZIP]
    metadata["attributes"]["atlas_sha256"] = f"{_root_hash(metadata)}-0"
    Path("a.zarr/zarr.json").write_text(json.dumps(metadata))
    write("a.zarr/label/c/0/0", gzip.compress(bytes(10**7)))
    with pytest.raises(BadInput, match="the values of label are damaged"):
        atlas.open_atlas("a.zarr").label.load()


def test_a_link_in_a_store_is_not_followed(folder):
    Path("a.zarr/label/c/0/0").unlink()
    Path("a.zarr/label/c/0/0").symlink_to(folder.parent / "secret")
    with pytest.raises(BadInput, match=r"no regular file \(a symbolic link"):
        atlas.open_atlas("a.zarr").label.load()
    shutil.move("a.zarr/status", folder.parent / "elsewhere")
    Path("a.zarr/status").symlink_to(folder.parent / "elsewhere")
    with pytest.raises(BadInput, match=r"no regular file \(a symbolic link"):
        atlas.open_atlas("a.zarr").status.load()


@pytest.mark.parametrize("size", [0, 1, 255, 256, 300, 66_000, 1_000_000])
def test_unpacked_bytes_are_those_of_the_codecs(size):
    from numcodecs import blosc, zstd

    assert _unpacked_bytes(bytes(zstd.compress(bytes(size))), "zstd", 1 << 20) == size
    assert _unpacked_bytes(gzip.compress(bytes(size)), "gzip", 1 << 20) == size
    assert _unpacked_bytes(2 * gzip.compress(bytes(size)), "gzip", 1 << 21) == 2 * size
    if size:
        assert _unpacked_bytes(bytes(blosc.compress(bytes(size), b"lz4", 1)), "blosc", 1 << 20) == size
