"""Memoised assemblies and warnings equal new ones bit for bit and are keyed by all their inputs."""

import shutil
from dataclasses import dataclass, fields

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from support.contents import same

from mic.model.assembly import assemble
from mic.plausibility import find_warnings
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format
from mic.system.memoise import memoise, pack, unpack

THING = Format("thing", 1, ABSENT)


@dataclass(frozen=True)
class Leaf:
    name: str
    values: np.ndarray
    more: object = None


CONTENT = {
    "leaves": (Leaf("a", np.arange(6.0).reshape(2, 3)), Leaf("b", np.zeros((0, 3)), [1, 2.5, None, True])),
    "whole": np.array([[3, 1]], dtype=np.int8),
    "names": np.array(["one", "three"]),
    "matrix": csr_matrix([[0.0, 2.0, 0.0], [1.0, 0.0, 0.0]]),
    "endless": float("inf"),
}


def test_unpacked_content_equals_packed_content():
    known = {"here": Leaf("known", np.ones(2))}
    content = CONTENT | {"known": known["here"]}
    header, arrays = pack(content, known)
    found = unpack(header, arrays, (Leaf,), known)
    assert same(found, content) and found["known"] is known["here"]
    assert len(arrays) == 4  # one a kind, however many there are


def test_only_named_classes_are_unpacked():
    header, arrays = pack(CONTENT, {})
    with pytest.raises(KeyError, match="Leaf"):
        unpack(header, arrays, (), {})
    for other in (np.array([object()]), object()):
        with pytest.raises(TypeError):
            pack(other, {})


def test_a_result_is_computed_once_for_its_inputs(tmp_path, monkeypatch):
    made, room = [], Cache(tmp_path, "assemblies", THING, 2)

    def found(content):
        value, identity = memoise(room, content, {}, (Leaf,), lambda: made.append(content) or CONTENT)
        assert same(value, CONTENT)
        return identity

    assert found([1]) == found([1]) and len(made) == 1
    assert found([2]) != found([1]) and len(made) == 2
    monkeypatch.setattr("mic.system.memoise.program", lambda: ["another line of the program"])
    found([1])
    assert len(made) == 3
    assert len(list((tmp_path / "assemblies").iterdir())) == 2  # no more than were asked for


@pytest.fixture(scope="module")
def small_scene(lap_scene):
    """The lap joint on coarse meshes with two pairs."""
    parts = [part.model_copy(update={"size": "coarse"}) for part in lap_scene.parts]
    zones = [zone.model_copy(update={"pairs": 2}) for zone in lap_scene.zones]
    return lap_scene.model_copy(update={"parts": parts, "zones": zones})


def changed_scenes(scene, folder):
    """Scenes that differ in one thing each that pairs, rows or parts follow from."""
    (zone, *zones), (clamp, *clamps), (part, *parts) = scene.zones, scene.clamps, scene.parts
    yield scene.model_copy(update={"zones": [zone.model_copy(update={"friction": 0.3}), *zones]})
    x, y, z = clamp.point
    yield scene.model_copy(update={"clamps": [clamp.model_copy(update={"point": (x + 1.0, y, z)}), *clamps]})
    yield scene.model_copy(update={"parts": [part.model_copy(update={"thickness": 1.01 * part.thickness}), *parts]})
    yield scene.model_copy(update={"report": scene.report.model_copy(update={"laws": ["frictionless"]})})
    script = shutil.copytree(scene.folder, folder) / part.geometry
    script.write_text(script.read_text(encoding="utf-8") + "\nOTHER = 1\n", encoding="utf-8")
    yield scene.model_copy(update={"folder": folder})


@pytest.mark.slow
def test_a_cached_assembly_equals_a_new_one_and_belongs_to_one_scene(small_scene, tmp_path, monkeypatch):
    there = lambda: len(list((tmp_path / "assemblies").iterdir()))
    first, again = assemble(small_scene, tmp_path), assemble(small_scene, tmp_path)
    assert there() == 1 and first.identity == again.identity
    assert all(same(getattr(first, one.name), getattr(again, one.name)) for one in fields(first) if one.name != "scene")
    more = small_scene.monte_carlo.model_copy(update={"samples": 7, "seed": 3})
    other = assemble(small_scene.model_copy(update={"monte_carlo": more, "name": "other"}), tmp_path)
    assert there() == 1 and other.scene.name == "other" and other.scene.monte_carlo.samples == 7
    for count, scene in enumerate(changed_scenes(small_scene, tmp_path / "scene"), 2):
        found = assemble(scene, tmp_path)
        assert there() == count and found.identity != first.identity
    monkeypatch.setattr("mic.system.memoise.program", lambda: ["another line of the program"])
    assemble(small_scene, tmp_path)
    assert there() == count + 1


@pytest.mark.slow
def test_warnings_are_cached_for_each_scene(small_scene, tmp_path):
    assembly = assemble(small_scene, tmp_path)
    expected = find_warnings(small_scene, assembly, tmp_path)
    assert expected == find_warnings(small_scene, assembly, tmp_path) == find_warnings(small_scene, assembly)
    soft = [part.model_copy(update={"young": 1e3}) for part in small_scene.parts]
    odd = assemble(small_scene.model_copy(update={"parts": soft}), tmp_path)
    warned = find_warnings(small_scene, odd, tmp_path)
    assert warned != expected and warned == find_warnings(small_scene, odd, tmp_path)
