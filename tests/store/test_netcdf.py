"""Atlas files and the one hash of all that they hold."""

import os
import tomllib
from contextlib import nullcontext
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from truth import assert_same_bytes

import atlas
from atlas import BadInput, files
from atlas.cli import main
from atlas.plotting import style
from atlas.store import dataset, netcdf

ATTRIBUTES = {"atlas_system": "satellite", "atlas_version": "0"}


def written(path, **variables) -> xr.Dataset:
    """A data set written with its hash, in chunks of 3 along each axis, or in eight of a long one."""
    ds = xr.Dataset(variables, attrs=ATTRIBUTES)
    encoding = {
        name: {
            "zlib": True,
            "fletcher32": True,
            "chunksizes": [min(n, max(3, n // 8)) for n in variable.shape],
        }
        for name, variable in ds.variables.items()
        if variable.ndim and variable.dtype.kind != "O"
    }
    ds.to_netcdf(path, engine="netcdf4", encoding=encoding)
    with netCDF4.Dataset(path, "r+") as file:
        file.setncattr(dataset.HASH, netcdf._hash(file))
    return ds


@pytest.fixture(scope="module")
def small_file(tmp_path_factory, small_scene):
    path = tmp_path_factory.mktemp("checksums") / "small.nc"
    atlas.run(small_scene, path, progress=False).close()
    return path


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    path = tmp_path_factory.mktemp("cube") / "cube.nc"
    numbers = np.random.default_rng(1).normal(size=(7, 5, 4))
    written(path, numbers=(("x", "y", "z"), numbers)).close()
    return path, numbers


def indices(length: int) -> st.SearchStrategy:
    whole = st.integers(-length, length - 1)
    slices = st.slices(length).filter(lambda k: len(range(length)[k]) > 0)  # xarray refuses some empty ones
    return st.one_of(whole, slices, st.lists(whole, min_size=1, max_size=4).map(np.array))


@given(st.tuples(indices(7), indices(5), indices(4)))
def test_any_selection_reads_the_values_that_were_written(cube, key):
    path, numbers = cube
    for axis, k in reversed(list(enumerate(key))):
        numbers = numbers[(slice(None),) * axis + (k,)]
    with atlas.open_atlas(path) as ds:
        np.testing.assert_array_equal(ds.numbers[key].values, numbers)


def test_texts_scalars_and_flags_are_read_as_written(tmp_path):
    ds = written(
        tmp_path / "a.nc",
        texts=("x", np.array(["one", "", "three", "four"], dtype=object)),
        number=((), 0.1),
        flags=(("x", "y"), np.arange(20, dtype=np.int8).reshape(4, 5)),
        plain=("long", np.arange(netcdf.ROW_VALUES + 10.0)),
    )
    with atlas.open_atlas(tmp_path / "a.nc") as read:
        xr.testing.assert_identical(read.load(), ds)
    netcdf.FORMAT.verify(tmp_path / "a.nc")


def test_all_variables_have_checksums_for_other_programs_as_well(small_file):
    with netCDF4.Dataset(small_file) as file:
        assert all(v.filters()["fletcher32"] for v in file.variables.values() if v.dimensions)
        assert sum(bool(v.dimensions) for v in file.variables.values()) > 20


def change_attribute(file):
    file["label"].long_name = "other"


def change_provenance(file):
    file.atlas_tolerance = 2e-5


def change_scalar(file):
    file["Omega"][...] = 1.5


def change_axis(file):
    file["theta0"][3] += 1e-9


def change_flag(file):
    file["label"][2, 2] = 1


def change_number(file):
    file["theta_max"][8, 6] += 1e-12


def rename_variable(file):
    file.renameVariable("theta_max", "theta_min_")


def lose_the_hash(file):
    file.delncattr(dataset.HASH)


CHANGES = (
    lose_the_hash, change_attribute, change_provenance, change_scalar, change_axis, change_flag, change_number, rename_variable
)  # fmt: skip


@pytest.mark.usual("change_flag", "rename_variable", "change_axis")
@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
def test_a_changed_file_is_refused_when_it_is_verified(small_file, tmp_path, change, capsys):
    path = tmp_path / "changed.nc"
    path.write_bytes(small_file.read_bytes())
    with netCDF4.Dataset(path, "r+") as file:
        file.set_auto_maskandscale(False)
        change(file)
    assert main(["status", str(small_file), "--verify"]) == 0
    assert main(["status", str(path), "--verify"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert ("has no hash" if change is lose_the_hash else "changed or damaged: its hash differs") in line


def rechunked(path, other, lengths):
    """A copy as other programs make it: the same data in chunks of at most these lengths, without compression."""
    with netCDF4.Dataset(path) as file, netCDF4.Dataset(other, "w") as copy:
        copy.setncatts({name: file.getncattr(name) for name in file.ncattrs()})
        for name, dimension in file.dimensions.items():
            copy.createDimension(name, len(dimension))
        for name, variable in file.variables.items():
            variable.set_auto_maskandscale(False)
            attributes = {key: variable.getncattr(key) for key in variable.ncattrs()}
            options = {"fill_value": attributes.pop("_FillValue", False)}
            if variable.shape and variable.dtype is not str:
                shorter = [min(pair) for pair in zip(variable.shape, lengths, strict=False)]
                options["chunksizes"] = shorter + [1] * (variable.ndim - len(shorter))
            new = copy.createVariable(name, variable.dtype, variable.dimensions, **options)
            new.set_auto_maskandscale(False)
            new.setncatts(attributes)
            new[...] = variable[...]


@pytest.mark.usual("20-lengths1", "8388608-lengths4")
@pytest.mark.parametrize("lengths", [(1, 1), (2, 3), (5, 2), (9, 1), (9, 7), (4, 7)])
@pytest.mark.parametrize("most", [1, 20, 1 << 23])
def test_copies_with_other_chunks_are_sound(small_file, tmp_path, monkeypatch, lengths, most):
    """However much of a row of chunks is read at once; a changed value in such a copy is found."""
    rechunked(small_file, tmp_path / "copy.nc", lengths)
    monkeypatch.setattr(netcdf, "MAX_ROW_VALUES", most)
    netcdf.FORMAT.verify(tmp_path / "copy.nc")
    with netCDF4.Dataset(tmp_path / "copy.nc", "r+") as file:
        change_number(file)
    with pytest.raises(BadInput, match=r"changed or damaged: its hash differs$"):
        netcdf.FORMAT.verify(tmp_path / "copy.nc")


def test_a_file_hashed_in_the_order_of_its_chunks_is_sound(small_file, tmp_path):
    """As earlier versions wrote it, with chunks that are no ranges of the C order."""
    rechunked(small_file, tmp_path / "a.nc", (2, 3))
    with netCDF4.Dataset(tmp_path / "a.nc", "r+") as file:
        earlier = netcdf._hash(file, by_chunks=True)
        assert earlier != netcdf._hash(file)
        file.setncattr(dataset.HASH, earlier)
    netcdf.FORMAT.verify(tmp_path / "a.nc")


def test_a_file_can_be_copied_into_a_classic_one(small_file, tmp_path, small_scene):
    """Integers of attributes have 32 bits or, where that is too few, are floats, which hold them exactly."""
    ds = atlas.label_points("satellite", {"m": [0.5, 0.6]}, duration=1.0)
    netcdf.write(ds.assign_attrs(many=10**10, few=7, some=[1, 2]), tmp_path / "points.nc")
    for path in (small_file, tmp_path / "points.nc"):
        with netCDF4.Dataset(path) as file:
            for owner in (file, *file.variables.values()):
                for name in owner.ncattrs():
                    assert np.asarray(owner.getncattr(name)).dtype not in (np.int64, np.uint64), name
    with atlas.open_atlas(tmp_path / "points.nc") as read:
        assert [read.many, read.few, read.some.tolist()] == [10**10, 7, [1, 2]]


@pytest.mark.long
def test_coordinates_that_users_write_have_no_fill_value(small_file, tmp_path, small_scene):
    """CF demands that of coordinate variables (section 2.5.1)."""
    points = atlas.label_points("satellite", {"m": [0.5, 0.6], "theta0": 0.2}, duration=1.0)
    with atlas.open_atlas(small_file) as opened:
        datasets = {
            "opened": opened,
            "part": opened.isel(sigma=slice(2)),
            "in memory": atlas.run(small_scene, progress=False),
            "joined": atlas.concat({"a": opened, "b": opened}, "kind"),
            "points": points,
            "nearest": opened.atlas.nearest(sigma=1.0),
            "motion": opened.atlas.trajectory(sigma=1.0, theta0=0.5, samples=3),
        }
        for name, ds in datasets.items():
            ds.to_netcdf(tmp_path / f"{name}.nc")
            with netCDF4.Dataset(tmp_path / f"{name}.nc") as file:
                filled = [each for each in ds.coords if "_FillValue" in file[each].ncattrs()]
            assert not filled, (name, filled)


@pytest.mark.long
def test_a_flipped_bit_is_found_when_the_file_is_verified(small_scene, tmp_path):
    """Anywhere, and often in the tables of chunks, which have no checksum of the library: what is verified holds the data.

    Of few variables, numbers and flags, because each of the 120 files is read whole.
    """
    path, table = tmp_path / "flipped.nc", tomllib.loads(small_scene)
    table["outputs"] = {"variables": ["label", "predicted", "status", "psi_dot_std", "theta_max"]}
    atlas.run(table, path, progress=False).close()
    whole = path.read_bytes()
    with atlas.open_atlas(path) as ds:
        truth = ds.load()
    rng = np.random.default_rng(5)
    table = whole.index(b"TREE")
    places = [*rng.integers(0, len(whole), 60), *rng.integers(table, table + 4000, 60)]
    refused = 0
    for place in places:
        content = bytearray(whole)
        content[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(content)
        try:
            netcdf.FORMAT.verify(path)
            with atlas.open_atlas(path) as ds:
                assert_same_bytes(truth, ds)
                assert repr(ds.attrs) == repr(truth.attrs)
        except BadInput as error:
            assert "\n" not in str(error)  # noqa: PT017
            refused += 1
    assert refused > 5


def test_a_damaged_chunk_is_refused_when_it_is_read(small_file, tmp_path, capsys):
    content = bytearray(small_file.read_bytes())
    for place in range(len(content) // 2, len(content), 97):
        content[place] ^= 8
    (tmp_path / "chunks.nc").write_bytes(content)
    assert main(["compare", f"{tmp_path}/chunks.nc"]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_a_file_that_claims_more_than_it_can_hold_is_refused(tmp_path):
    """In its variables, or in a group; chunks that are not stored take no room."""
    for place in ("/", "other"):
        with netCDF4.Dataset(tmp_path / "bomb.nc", "w") as file:
            file.setncatts(ATTRIBUTES)
            group = file if place == "/" else file.createGroup(place)
            group.createDimension("x", 10**12)
            group.createVariable("x", "i1", ("x",), zlib=True, chunksizes=[1000])
        with pytest.raises(BadInput, match=r"claims 1e\+12 bytes of numbers"):
            atlas.open_atlas(tmp_path / "bomb.nc")


@pytest.mark.long
def test_paths_that_the_library_takes_for_others_are_refused(small_file, small_scene, tmp_path):
    for name in ("back\\slash", os.fsdecode(b"\xff")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.nc").write_bytes(small_file.read_bytes())
        for action in (
            lambda path: atlas.open_atlas(path / "a.nc"),
            lambda path: files.writable(path / "b.nc", (".nc",), force=False),
            lambda path: atlas.run(small_scene, path / "run.nc"),
        ):
            with pytest.raises(BadInput, match="the NetCDF library opens no path") as error:
                action(tmp_path / name)
            assert str(error.value).isprintable()
        with atlas.run(
            small_scene, f"{tmp_path}/{name}/run/", progress=False
        ) as ds:  # no file of the library
            assert ds.label.values.any()


def test_a_full_disk_is_named_and_nothing_is_left(tmp_path, monkeypatch):
    """Of one-shot files and figures, for which the libraries raise errors of other kinds."""

    def fail(*arguments, **options):
        raise RuntimeError("NetCDF: HDF error")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", fail)
    monkeypatch.setattr(files, "MIN_FREE_BYTES", 1 << 62)
    with pytest.raises(OSError, match=r"No space left on device \(NetCDF: HDF error\)"):
        netcdf.write(xr.Dataset({"a": 1}), tmp_path / "a.nc")
    assert not list(tmp_path.iterdir())
    for name in ("a.png", "a.pdf", "a.svg"):
        with monkeypatch.context() as patched:
            patched.setattr(style, "atomic_write", lambda path: nullcontext(Path("/dev/full")))
            with pytest.raises(OSError, match="No space left"):
                style.save(Figure(), tmp_path / name)


def test_a_copy_without_checksums_can_be_opened(small_file, tmp_path):
    with atlas.open_atlas(small_file) as ds:
        ds.isel(sigma=slice(3)).to_netcdf(tmp_path / "part.nc")
    with atlas.open_atlas(tmp_path / "part.nc") as part:
        assert part.sizes["sigma"] == 3
