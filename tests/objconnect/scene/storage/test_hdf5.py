"""HDF5 files of unknown origin: neither other files nor false sizes are read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from objconnect.scene.bundle.covisibility import Covisibility, read_covisibility, write_covisibility
from objconnect.scene.bundle.frames import dense_layers, read_frames, write_frames
from objconnect.scene.errors import InputError
from objconnect.scene.maps.features import read_features
from objconnect.scene.storage.hdf5 import array, attribute, group, groups, set_text
from tests.objconnect.scene.bundle.test_frames import ALL, make_frames, make_layers


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """Write a file outside the scene."""
    path = tmp_path / "secret.h5"
    with h5py.File(path, "w") as file:
        file["time"] = np.arange(3.0)
        file["names"] = np.array([b"x", b"y", b"z"])
    return path


def external_link(file: h5py.File, name: str, secret: Path) -> None:
    file[name] = h5py.ExternalLink(secret, "/time")


def external_bytes(file: h5py.File, name: str, secret: Path) -> None:
    file.create_dataset(name, (3,), "f8", external=[(secret, 0, 24)])


def virtual(file: h5py.File, name: str, secret: Path) -> None:
    layout = h5py.VirtualLayout((3,), "f8")
    layout[...] = h5py.VirtualSource(secret, "time", (3,))
    file.create_virtual_dataset(name, layout)


def virtual_of_itself(file: h5py.File, name: str, secret: Path) -> None:
    """The HDF5 library would follow such a link until the process dies."""
    layout = h5py.VirtualLayout((3,), "f8")
    layout[...] = h5py.VirtualSource(".", f"{file.name}/{name}", (3,))
    file.create_virtual_dataset(name, layout)


def soft_link(file: h5py.File, name: str, secret: Path) -> None:
    file[name] = h5py.SoftLink("/gps_sigma")


def huge(file: h5py.File, name: str, secret: Path) -> None:
    """A file of a few bytes claims 2^60 numbers."""
    file.create_dataset(name, (2**60,), "f8", chunks=(1,))


def huge_chunk(file: h5py.File, name: str, secret: Path) -> None:
    file.create_dataset(name, (3,), "f8", maxshape=(None,), chunks=(2**28,), compression="gzip")


def variable_length(file: h5py.File, name: str, secret: Path) -> None:
    file.create_dataset(name, data=np.full(3, "x", object), dtype=h5py.string_dtype())


def a_group(file: h5py.File, name: str, secret: Path) -> None:
    file.create_group(name)


def empty(file: h5py.File, name: str, secret: Path) -> None:
    file[name] = h5py.Empty("f8")


Spoil = Callable[[h5py.File, str, Path], None]
SPOILERS = [
    *(external_link, external_bytes, virtual, virtual_of_itself, soft_link, huge, huge_chunk),
    *(variable_length, a_group, empty),
]


@pytest.mark.parametrize("spoil", SPOILERS)
@pytest.mark.parametrize("name", ["time", "names", "cam_from_world", "depth"])
def test_frames(spoil: Spoil, name: str, tmp_path: Path, secret: Path) -> None:
    path = tmp_path / "frames.h5"
    write_frames(path, make_frames(3), ALL, (make_layers(k) for k in range(3)))
    with h5py.File(path, "r+") as file:
        del file[name]
        spoil(file, name, secret)
    if name == "depth":
        with dense_layers(path) as layers, pytest.raises(InputError, match=r"frames\.h5.*damaged"):
            layers.read("depth", 0)
    else:
        with pytest.raises(InputError, match=r"frames\.h5"):
            read_frames(path)


@pytest.mark.parametrize("spoil", SPOILERS)
def test_covisibility_and_features(spoil: Spoil, tmp_path: Path, secret: Path) -> None:
    path = tmp_path / "c.h5"
    write_covisibility(path, Covisibility(("a", "b", "c"), np.zeros((3, 3))))
    with h5py.File(path, "r+") as file:
        del file["overlap"]
        spoil(file, "overlap", secret)
    with pytest.raises(InputError, match="damaged"):
        read_covisibility(path)
    with h5py.File(tmp_path / "f.h5", "w") as file:
        group = file.create_group("a.jpg")
        group["xy"], group["scale"] = np.zeros((3, 2)), np.ones(3)
        spoil(group, "descriptors", secret)
    with pytest.raises(InputError, match="damaged"):
        read_features(tmp_path / "f.h5")


def test_groups_are_of_the_file(tmp_path: Path, secret: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_group("a")
        assert [name for name, _ in groups(file)] == ["a"]
        file["b"] = h5py.ExternalLink(secret, "/")
        with pytest.raises(ValueError, match="link"):
            list(groups(file))


def test_attributes_and_groups_from_strangers(tmp_path: Path, secret: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        set_text(file, "text", "größer")
        file.attrs["numbers"] = [4, 3]
        assert attribute(file, "text") == "größer"
        assert attribute(file, "numbers").tolist() == [4, 3]
        file.attrs["endless"] = "x"
        with pytest.raises(ValueError, match="variable length"):
            attribute(file, "endless")
        with pytest.raises(KeyError):
            attribute(file, "none")
        file["there"] = h5py.ExternalLink(secret, "/")
        with pytest.raises(ValueError, match="link"):
            group(file, "there")
        with pytest.raises(KeyError):
            group(file, "none")


@pytest.mark.parametrize("name", ["/etc/passwd", "../../x.jpg", "a/../../b.jpg", ".."])
def test_frames_lie_in_the_scene(name: str, tmp_path: Path) -> None:
    path = tmp_path / "frames.h5"
    write_frames(path, make_frames(1), (), iter(()))
    with h5py.File(path, "r+") as file:
        del file["names"]
        file["names"] = np.array([name.encode()])
    with pytest.raises(InputError, match="does not lie in the scene"):
        read_frames(path)


def test_what_is_packed_well_is_read(tmp_path: Path) -> None:
    """Zeros are compressed by a factor of a thousand."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("a", data=np.zeros((4, 2**20), "u1"), compression=9, chunks=(1, 2**20))
        assert array(file, "a").shape == (4, 2**20)
