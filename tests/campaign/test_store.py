"""The store: resume, damage, changed studies, locks."""

from __future__ import annotations

import json
import pickle
import shutil
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from celnav.campaign import StoreError, campaign, serial
from celnav.campaign.missions import study
from celnav.campaign.table import columns, to_csv, to_parquet
from celnav.campaign.units import units_of
from celnav.files import ForeignFileError, Outputs, locked
from celnav.study import store as stores

TABLE = {
    "paper": "csrukf",
    "filters": ["csrukf"],
    "runs": 6,
    "block": 2,
    "config": {"steps": 8, "phi": [0.0, 0.8]},
}


def table(outcome):
    cells = columns(outcome.rows)
    return to_csv(cells), to_parquet(cells)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished campaign: its folder, and its table."""
    folder = tmp_path_factory.mktemp("finished") / "store"
    return folder, table(campaign(study(TABLE), folder))


@pytest.fixture
def made(finished, tmp_path):
    """A copy of it."""
    return shutil.copytree(finished[0], tmp_path / "store"), finished[1]


def again(folder):
    """Run once more; returns the table, the warnings, and which files were written."""
    before = {path: path.stat().st_mtime_ns for path in (folder / "units").iterdir()}
    said = []
    found = table(campaign(study(TABLE), folder, serial(), say=said.append))
    return (
        found,
        said,
        {p.name for p in (folder / "units").iterdir() if p.stat().st_mtime_ns != before.get(p)},
    )


def test_a_finished_campaign_is_read_and_not_computed(made):
    folder, wanted = made
    assert again(folder) == (wanted, [], set())


def test_what_a_killed_campaign_left_half_written_is_removed(made):
    folder, wanted = made
    for part in (folder, folder / "units"):
        code = "import os, sys; from celnav.files import replacing; r = replacing(sys.argv[1]); r.__enter__().touch(); os._exit(9)"
        assert (
            subprocess.run(
                [sys.executable, "-c", code, str(part / "x.npz")], check=False
            ).returncode
            == 9
        )
        assert len(list(part.glob(".celnav-*/x.npz"))) == 1
    assert again(folder) == (wanted, [], set())
    assert not list(folder.rglob(".celnav-*"))


def test_what_celnav_did_not_make_stays_whatever_its_name_begins_with(made):
    folder, wanted = made
    (theirs := folder / ".celnav-notes").mkdir()
    (theirs / "mine.txt").write_text("mine")
    (folder / "units" / ".celnav-notes").symlink_to(theirs)
    assert again(folder) == (wanted, [], set())
    assert (folder / "units" / ".celnav-notes" / "mine.txt").read_text() == "mine"


def test_missing_units_alone_are_computed(made):
    folder, wanted = made
    lost = sorted((folder / "units").iterdir())[1:3]
    for path in lost:
        path.unlink()
    assert again(folder) == (wanted, [], {path.name for path in lost})


def flip(path):
    content = bytearray(path.read_bytes())
    with np.load(path) as stored:
        content[content.index(stored["0/square"].tobytes())] ^= 0xFF
    path.write_bytes(content)


def repack(path, **change):
    with np.load(path) as stored:
        arrays = {name: stored[name] for name in stored.files}
    np.savez(path, **(arrays | change))


def sealed(**change):
    """A unit with other arrays and their correct checksum."""

    def damage(path):
        (unit,) = (u for part in units_of(study(TABLE)) for u in part if u.key == path.stem)
        with np.load(path) as stored:
            arrays = {name: stored[name] for name in stored.files if name != "checksum"}
        for name, value in change.items():
            arrays[name] = value(arrays[name]) if callable(value) else value
        np.savez(path, **arrays, checksum=np.array(stores._checksum(unit, arrays)))

    return damage


def swap(path):
    """Copy another unit over it."""
    (path).write_bytes(sorted(path.parent.iterdir())[0].read_bytes())


def plant(path):
    """An array with an object that leaves a mark when it is unpickled."""
    np.savez(
        path, allow_pickle=True, about=np.array([Mark(str(path.parent / "mark"))], dtype=object)
    )


class Mark:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (self.path, "w")


@pytest.mark.parametrize(
    "damage",
    [
        flip,
        lambda path: path.write_bytes(path.read_bytes()[:-100]),
        lambda path: path.write_bytes(b""),
        lambda path: repack(path, **{"0/square": np.zeros((9, 2))}),
        lambda path: repack(path, checksum=np.array("0")),
        lambda path: repack(path, about=np.array("{}")),
        lambda path: zipfile.ZipFile(path, "w").close(),
        plant,
        swap,
        sealed(**{"0/square": np.zeros((7, 3))}),
        sealed(**{"0/times": np.array(3.0)}),
        sealed(**{"0/runs": np.array("two")}),
        sealed(**{"0/extra": np.zeros(3)}),
        sealed(about=lambda text: np.array(str(text).replace("csrukf", "srukf"))),
        sealed(about=np.array("[]")),
        sealed(about=np.array("[" * 100_000)),
        sealed(about=lambda text: np.array(str(text).replace('"position", ', ""))),
    ],
    ids=[
        "flipped",
        "truncated",
        "empty",
        "changed",
        "checksum",
        "about",
        "zip",
        "object",
        "swapped",
        "shape",
        "number",
        "words",
        "extra",
        "filter",
        "list",
        "deep",
        "groups",
    ],
)
def test_a_damaged_unit_is_named_and_computed_again(made, damage):
    folder, wanted = made
    victim = sorted((folder / "units").iterdir())[2]
    damage(victim)
    found, said, written = again(folder)
    assert found == wanted
    assert written == {victim.name}
    assert len(said) == 1
    assert said[0].startswith(str(victim))
    assert said[0].endswith("it is computed again")
    assert not (victim.parent / "mark").exists()


def test_units_of_other_epochs_are_told(made):
    """Each unit is complete, with the right checksum, but together they do not fit."""
    folder, _ = made
    victim = sorted((folder / "units").iterdir())[1]
    with np.load(victim) as stored:
        longer = {
            n: np.concatenate([stored[n]] * 2)
            for n in stored.files
            if stored[n].shape[:1] == stored["0/times"].shape
        }
    sealed(**longer)(victim)
    with pytest.raises(StoreError, match=r"its units do not go together \(.*\); remove the folder"):
        campaign(study(TABLE), folder)


def test_the_planted_object_would_have_left_its_mark(tmp_path):
    pickle.loads(pickle.dumps(Mark(str(tmp_path / "mark")))).close()
    assert (tmp_path / "mark").exists()


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        ({"runs": 4}, "runs: 6 -> 4"),
        ({"runs": 8, "seed": 1}, "seed: 0 -> 1"),
        ({"config": {"steps": 8, "phi": [0.0]}}, r"config.phi: \[0.0, 0.8\] -> \[0.0\]"),
        ({"config": {"steps": 8, "phi": 0.8}}, r"config.phi: \[0.0, 0.8\] -> 0.8"),
        ({"seed": 1}, "seed: 0 -> 1"),
        ({"config": {"steps": 9, "phi": [0.0, 0.8]}}, "config.steps: 8 -> 9"),
        ({"config": {"steps": 8, "phi": [0.0, 0.9]}}, r"config.phi: \[0.0, 0.8\] -> \[0.0, 0.9\]"),
        ({"limits": {"position": 1.0}}, "limits.position: absent -> 1.0"),
        ({"filters": ["srukf"]}, r'filters: \["csrukf"\] -> \["srukf"\]'),
    ],
)
def test_another_study_is_refused_with_the_difference(made, change, difference):
    folder, wanted = made
    with pytest.raises(
        StoreError, match=rf"belongs to another study \({difference}\); choose another --out"
    ):
        campaign(study(TABLE | change), folder)
    assert again(folder) == (wanted, [], set())


@pytest.mark.parametrize(
    ("change", "flown"),
    [
        ({"runs": 8}, 2 * 2),
        ({"runs": 7}, 2 * 1),
        ({"config": {"steps": 8, "phi": [0.0, 0.5, 0.8]}}, 6),
        (
            {"config": {"steps": 8, "phi": [0.8, 0.0], "sigma_km": [0.1, 0.2]}},
            2 * 6,
        ),  # 0.2 is the old value
        ({"runs": 10, "config": {"steps": 8, "phi": [0.9, 0.8, 0.0]}}, 10 + 2 * 4),
    ],
)
def test_a_finished_campaign_grows_and_flies_only_what_is_new(made, tmp_path, change, flown):
    """More runs, one more value, or several values instead of one: the table equals the table of
    all units computed at once.
    """
    folder, _ = made
    seen = []
    found = table(
        campaign(
            study(TABLE | change), folder, progress=lambda done, total: seen.append((done, total))
        )
    )
    assert found == table(campaign(study(TABLE | change), tmp_path / "at once"))
    assert seen[-1][0] - seen[0][0] == flown
    assert seen[-1][0] == seen[-1][1]
    with pytest.raises(
        StoreError, match="belongs to another study"
    ):  # now the folder has the larger campaign
        campaign(study(TABLE), folder)


def test_a_block_that_was_not_whole_is_flown_anew_with_the_runs_that_fill_it(tmp_path):
    seen = []
    for runs in (3, 6):
        found = campaign(
            study(TABLE | {"runs": runs}),
            tmp_path / "grown",
            progress=lambda done, _: seen.append(done),
        )
    assert seen == [0, 2, 3, 5, 6, 4, 6, 8, 10, 12]
    assert table(found) == table(campaign(study(TABLE), tmp_path / "at once"))


@pytest.mark.parametrize("what", ["celnav", "code", "numpy", "scipy"])
def test_a_store_of_another_version_is_refused_with_the_difference(made, what):
    folder, _ = made
    manifest = folder / stores.MANIFEST
    about = json.loads(manifest.read_text())
    about["code"][what] = "1.0"
    manifest.write_text(json.dumps(about))
    with pytest.raises(StoreError, match=rf'was begun with another celnav \({what}: "1\.0" -> "'):
        campaign(study(TABLE), folder)


def test_another_title_is_the_same_study(made):
    folder, wanted = made
    assert table(campaign(study(TABLE | {"title": "another"}), folder)) == wanted


def test_whatever_byte_is_damaged_nothing_wrong_is_read(made):
    folder, _ = made
    store = stores.open_store(folder, study(TABLE).to_dict(), ())
    unit = units_of(study(TABLE))[0][0]
    path, whole = store.path(unit), store.read(unit)
    content = path.read_bytes()
    refused = 0
    for at in range(0, len(content), 41):
        for bit in (0x01, 0x80):
            damaged = bytearray(content)
            damaged[at] ^= bit
            path.write_bytes(damaged)
            try:
                found = store.read(unit)
            except ValueError as error:
                refused += str(path) in str(error)
                continue
            assert found.keys() == whole.keys()
            for name, value in found.items():
                np.testing.assert_array_equal(value, whole[name])
    assert refused > 0.6 * len(content) / 41 * 2


@pytest.mark.parametrize("content", [b"", b"{}", b"[]", b"\xff", b'{"format": 99}', b"[" * 100_000])
def test_a_manifest_that_is_none_is_refused(made, content):
    folder, _ = made
    (folder / stores.MANIFEST).write_bytes(content)
    with pytest.raises(StoreError, match=r"manifest\.json: not a manifest"):
        campaign(study(TABLE), folder)


def test_units_without_a_manifest_are_refused(made):
    folder, _ = made
    (folder / stores.MANIFEST).unlink()
    with pytest.raises(StoreError, match="has units but no manifest"):
        campaign(study(TABLE), folder)


def test_a_second_process_is_told(made):
    folder, _ = made
    with locked(folder), pytest.raises(BlockingIOError, match="in use by another celnav process"):
        campaign(study(TABLE), folder)


def test_an_interrupted_campaign_goes_on_where_it_was(tmp_path, made):
    folder, wanted = tmp_path / "interrupted", made[1]
    calls = []

    def progress(done, total):
        calls.append(done)
        if len(calls) == 4:
            raise KeyboardInterrupt("at the fourth call")

    with pytest.raises(KeyboardInterrupt, match=r"^at the fourth call$"):
        campaign(study(TABLE), folder, progress=progress)
    assert len(list((folder / "units").iterdir())) == 3
    seen = []
    assert (
        table(
            campaign(study(TABLE), folder, progress=lambda done, total: seen.append((done, total)))
        )
        == wanted
    )
    assert seen == [(6, 12), (8, 12), (10, 12), (12, 12)]


def test_every_file_of_the_plan_is_there_and_no_other(made):
    folder, _ = made
    plan = {f"{u.key}.npz" for part in units_of(study(TABLE)) for u in part}
    assert {p.name for p in (folder / "units").iterdir()} == plan


def test_a_foreign_folder_named_units_is_left_alone(tmp_path):
    (tmp_path / "units").mkdir()
    (tmp_path / "units" / "mine.txt").write_text("mine")
    with pytest.raises(StoreError, match="has units"):
        campaign(study(TABLE), tmp_path)
    assert (tmp_path / "units" / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize("name", ["figures", "tables"])
def test_a_folder_that_is_a_link_is_refused_and_one_that_is_reached_by_one_is_not(tmp_path, name):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(
        ForeignFileError, match=rf"out/{name}: expected a folder, got a symbolic link"
    ):
        Outputs(tmp_path / "out").text(f"{name}/a.txt", "ours")
    assert not list((tmp_path / "elsewhere").iterdir())
    (tmp_path / "disk").symlink_to(tmp_path / "elsewhere")
    Outputs(tmp_path / "disk").text(f"{name}/a.txt", "ours")
    assert (tmp_path / "elsewhere" / name / "a.txt").read_text() == "ours"


def test_a_foreign_table_is_left_alone(made):
    folder, _ = made
    (folder / "table.csv").write_text("mine")
    with pytest.raises(ForeignFileError, match=r"table\.csv"):
        Outputs(folder).check(["table.csv"])
