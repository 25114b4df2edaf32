"""A store of a sweep with flipped bits: every reader says so and names the file, a run that goes on makes it whole, no answer changes.

One wrong bit, three beside each other or a cut end: what disks and transfers do. Bits are drawn with a seed.
"""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.cli import main
from gainroom.studies.sweep.checksums import own_digest
from gainroom.studies.sweep.plan import drawn
from gainroom.studies.sweep.store import Store, open_sweep
from gainroom.studies.sweep.summary import summarized
from gainroom.studies.sweep.workspace import checked_on, with_worst_of
from robot_files import ROBOT, write_arm
from sweep_runs import CHUNK, contents, ran, small_plan

UNSURE = "uncertainty: {delay_ms: [1.0, 2.5], stiffness: [6000.0, 9000.0]}\n"
BITS = 400
SEED = 20261129


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A plan, its finished store and every file in it."""
    folder = tmp_path_factory.mktemp("whole")
    file = write_arm(folder, ROBOT.partition("tasks:")[0] + UNSURE)
    plan = small_plan(file, CHUNK + 9)
    plan = replace(plan, places=drawn(plan.system, 1))
    ran(plan, folder / "sweep.zarr", workers=1)
    return plan, folder / "sweep.zarr", contents(folder / "sweep.zarr")


@pytest.fixture
def copied(whole, tmp_path):
    plan, path, before = whole
    shutil.copytree(path, tmp_path / "sweep.zarr")
    return plan, tmp_path / "sweep.zarr", before


def flipped(content: bytes, bit: int) -> bytes:
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def drawn_bits(files: dict[str, bytes], count: int) -> list[tuple[str, int]]:
    """Half of them alike over all bits, half alike over all files: small ones are metadata."""
    rng, names = np.random.default_rng(SEED), sorted(files)
    sizes = np.array([8 * len(files[name]) for name in names])
    ends = np.cumsum(sizes)
    found = []
    for number in range(count):
        at = int(rng.integers(ends[-1])) if number % 2 else 0
        place = int(np.searchsorted(ends, at, side="right")) if number % 2 else int(rng.integers(len(names)))
        found.append((names[place], int(rng.integers(sizes[place]))))
    return found


def everything(path: Path) -> dict[str, list]:
    """All that a store's labelled arrays say; NaN as text."""
    found = open_sweep(path)
    values = {str(name): np.asarray(found.variables[name].values).astype(str).tolist() for name in found.variables}
    return values | {"attributes": json.dumps(found.attrs, sort_keys=True)}


def refusal(ask, *arguments) -> str:
    """What a question about a store is refused with; "" where it is answered."""
    try:
        ask(*arguments)
    except gr.GainroomError as error:
        return str(error)
    return ""


def assert_told_and_mended(plan, path: Path, before: dict[str, bytes], bits: list[tuple[str, int]]) -> None:
    """Through Python's arrays, and by going on: the file is named, and afterwards every byte is as before.

    But for what says whose the store is: that is refused and left as it is.
    """
    for name, bit in bits:
        harmed = {**before, name: flipped(before[name], bit)}
        (path / name).write_bytes(harmed[name])
        said = refusal(everything, path)
        assert said.startswith(f"{path}: "), (name, bit)
        assert name in said or (name == "zarr.json" and "of a sweep" in said), said
        assert "\n" not in said
        refused = refusal(Store.of, path, plan) if name == "zarr.json" else ""
        assert bool(refused) == (name == "zarr.json")
        if refused:
            assert contents(path) == harmed
            (path / name).write_bytes(before[name])
            continue
        store = Store.of(path, plan)
        named = [*store.mended, *ran(plan, path, workers=1).damaged]
        assert len(named) == 1, (name, bit)
        assert name in named[0]
        assert contents(path) == before, (name, bit)


def test_flipped_bits_are_told_and_mended(copied):
    assert_told_and_mended(*copied, drawn_bits(copied[2], 8))


@pytest.mark.population
def test_400_flipped_bits_are_all_told_and_all_mended(copied):
    assert_told_and_mended(*copied, drawn_bits(copied[2], BITS))


@pytest.mark.slow
def test_flipped_bits_change_no_answer_of_the_commands(tmp_path, capsys):
    """sweep and robot --sweep: the answer is that of a whole store, or one line and status 2."""
    file = write_arm(tmp_path, ROBOT.partition("tasks:")[0] + UNSURE)
    file.write_text(file.read_text() + "limits: {gain_margin_db: 6}\n")
    store = tmp_path / "ours.zarr"
    calls = {
        "sweep": ["sweep", str(file), "--samples", "40", "--margins", "2", "--output", str(store), "--workers", "1", "--json"],
        "robot": ["robot", str(file), "--sweep", str(store), "--json"],
    }
    kept = {}
    for name, call in calls.items():
        assert main(call) < 2
        kept[name] = json.loads(capsys.readouterr().out)
    files = contents(store)
    for name, bit in drawn_bits(files, 24):
        (store / name).write_bytes(flipped(files[name], bit))
        status = main(calls["robot"])
        out, err = capsys.readouterr()
        if status < 2:  # a file that it does not look at
            assert json.loads(out) == kept["robot"], (name, bit)
        else:
            assert (out, err.count("\n")) == ("", 1), err
        status = main(calls["sweep"])
        out, err = capsys.readouterr()
        if name == "zarr.json":
            assert (status, out, err.count("\n")) == (2, "", 1)
            (store / name).write_bytes(files[name])
            continue
        said = json.loads(out)
        assert any(name in warning and "computed again" in warning for warning in said.pop("warnings"))
        assert said == {key: value for key, value in kept["sweep"].items() if key != "warnings"}
        assert contents(store) == files


HARMS = {
    "cut": lambda content: content[:-5],
    "empty": lambda content: b"",
    "lost": lambda content: None,
    "swapped bytes": lambda content: content[:3] + content[4:2:-1] + content[5:],
    "three bits": lambda content: flipped(flipped(flipped(content, 9), 10), 12),
}


def asked_all(plan, path: Path) -> None:
    with_worst_of(plan.system, path)
    checked_on(plan.system, path)
    everything(path)


@pytest.mark.parametrize("harm", [pytest.param(name, marks=() if name in ("cut", "lost") else pytest.mark.slow) for name in HARMS])
def test_other_damage_is_told_and_mended(copied, harm):
    plan, path, before = copied
    for name in ("gain/c/0/0/1", "angles/c/0/0", "joint/c/0", "gain/zarr.json", "draw_delay/c/0/0", "certified/c/1/0/0"):
        changed = HARMS[harm](before[name])
        assert changed != before[name]
        (path / name).unlink()
        if changed is not None:
            (path / name).write_bytes(changed)
        assert refusal(asked_all, plan, path), name
        ran(plan, path, workers=1)
        assert contents(path) == before, name


def test_a_value_outside_its_meaning_is_damage(copied):
    """Written with its checksum, as by a program that is wrong: no gain is negative, no joint has that number."""
    plan, path, before = copied
    for name, value in (("gain", -1.7e35), ("lower_gain", np.inf), ("frequency", -1.0), ("limiting_joint", 7)):
        store = Store.of(path, plan)
        store._arrays[name][0, 0, 3] = value
        with pytest.raises(gr.GainroomError, match=f"is damaged: {name}/c/0/0/0"):
            summarized(plan, store.finished())
        assert name in ran(plan, path, workers=1).damaged[0]
        assert contents(path) == before


def test_a_store_without_checksums_is_refused_plainly(copied, capsys):
    plan, path, _ = copied
    about = path / "zarr.json"
    group = json.loads(about.read_text())
    del group["attributes"]["checksum"], group["attributes"]["metadata"]
    about.write_text(json.dumps(group).replace("gainroom sweep 3", "gainroom sweep 2"))
    left = contents(path)
    for ask in (lambda: Store.of(path, plan), lambda: open_sweep(path)):
        with pytest.raises(gr.GainroomError, match="by an older gainroom, without checksums: damage in it would not be seen"):
            ask()
    assert contents(path) == left


METADATA = {
    "no JSON": lambda group: b"{",
    "no text": lambda group: b"\xff\xfe gainroom sweep ",
    "a list": lambda group: b'["gainroom sweep "]',
    "deep": lambda group: b'{"gainroom sweep ":' + b"[" * 100_000,
    "attributes are a list": lambda group: json.dumps({**group, "attributes": [1]}).encode(),
    "no identity": lambda group: signed(group, identity=None),
    "a number for the identity": lambda group: signed(group, identity=3),
    "no digests": lambda group: signed(group, metadata=None),
    "a list of digests": lambda group: signed(group, metadata=[1]),
    "no count": lambda group: signed(group, count=None),
}


def signed(group: dict, **changes) -> bytes:
    """With attributes changed, and a right checksum: what a program that is wrong may write."""
    attributes = {key: value for key, value in {**group["attributes"], **changes}.items() if value is not None}
    group = {**group, "attributes": attributes}
    group["attributes"]["checksum"] = own_digest(group)
    return json.dumps(group).encode()


@pytest.mark.parametrize("case", METADATA)
def test_metadata_that_nobody_can_read_is_refused_in_one_line(copied, case):
    plan, path, before = copied
    (path / "zarr.json").write_bytes(METADATA[case](json.loads(before["zarr.json"])))
    left = contents(path)
    for ask in (lambda: Store.of(path, plan), lambda: with_worst_of(plan.system, path)):
        with pytest.raises(gr.GainroomError) as caught:
            ask()
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)
        assert contents(path) == left


@pytest.mark.parametrize("place", ["gain", "gain/c", "gain/c/1", "gain/c/1/0/0"])
def test_a_link_inside_is_not_followed_on_writing(copied, tmp_path, place):
    """To a folder or file elsewhere, which stays as it is, whatever was lost in the store."""
    plan, path, before = copied
    outside = tmp_path / "outside"
    shutil.move(path / place, outside)
    (path / place).symlink_to(outside)
    lost = path / "gain" / "c" / "1" / "0" / "0"
    lost.write_bytes(b"x" * 40)
    kept = {str(each): each.read_bytes() for each in (outside.rglob("*") if outside.is_dir() else [outside]) if each.is_file()}
    with pytest.raises(gr.GainroomError, match=rf"{place} is a link, which is not followed"):
        ran(plan, path, workers=1)
    assert all(Path(name).read_bytes() == content for name, content in kept.items())
    os.unlink(path / place)
    if place.count("/") < 2:
        return  # the rest of the store went with it
    ran(plan, path, workers=1)
    assert contents(path) == before


def test_a_link_to_a_whole_store_is_a_store(copied, tmp_path):
    plan, path, before = copied
    (tmp_path / "link.zarr").symlink_to(path)
    (path / "gain" / "c" / "0" / "0" / "0").unlink()
    ran(plan, tmp_path / "link.zarr", workers=1)
    assert contents(path) == before


def test_an_unfinished_sweep_is_no_worst_of_all(copied):
    """Postures that nobody has looked at may be the worst."""
    plan, path, _ = copied
    (path / "gain" / "c" / "1" / "0" / "1").unlink()
    with pytest.raises(gr.GainroomError, match="is not finished, gain/c/1/0/1 is missing"):
        with_worst_of(plan.system, path)
