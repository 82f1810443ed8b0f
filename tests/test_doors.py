"""Paths in options and arguments are checked before anything is computed: a missing path, or a file
instead of a folder and vice versa, gives one line and exit status 2.
"""

from __future__ import annotations

import pytest

from celnav import papers
from celnav.campaign.engine import UnfinishedError
from celnav.cli import main
from celnav.commands import reproduce
from celnav.files import InputError

STUDIES = [(study, f"--{study}") for study in papers.REAL]
READ = [
    *(("reproduce", study, option) for study, option in STUDIES),
    ("reproduce", "aukf", "--rinex"),
]


@pytest.mark.parametrize("kind", ["nothing", "a file", "an empty folder"])
@pytest.mark.parametrize("words", READ, ids=lambda words: words[1])
def test_a_folder_of_data_that_lacks_its_files_is_one_line(words, kind, tmp_path, capsys):
    place = tmp_path / "data"
    if kind == "a file":
        place.write_text("x")
    elif kind == "an empty folder":
        place.mkdir()
    assert main([*words, str(place), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert said.startswith((f"celnav: {place}: expected a ", f"celnav: {words[2]}: expected a "))
    assert str(place) in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    "words",
    [
        ["reproduce", "csrukf", "--out", "FILE"],
        ["reproduce", "NOTHING.py"],
        ["run", "NOTHING"],
        ["run", "FOLDER"],
        ["run", "FILE"],
        ["campaign", "NOTHING"],
        ["campaign", "FOLDER"],
        ["campaign", "FILE"],
        ["verdicts", "--out", "NOTHING"],
        ["verdicts", "--out", "FILE"],
        ["view", "NOTHING.rrd"],
        ["view", "csrukf", "--out", "NOTHING"],
        ["view", "csrukf", "--out", "FILE"],
        ["position", "NOTHING", "NOTHING"],
        ["position", "FOLDER", "FOLDER"],
        ["position", "FILE", "FILE"],
        ["position", "NOTHING", "NOTHING", "--out", "FILE"],
        ["position", "NOTHING", "NOTHING", "--ion", "NOTHING"],
        ["diagnose", "NOTHING"],
        ["diagnose", "FOLDER"],
        ["diagnose", "FILE"],
        ["diagnose", "NOTHING", "--out", "FILE"],
        ["list", "NOTHING.py"],
        ["new", "FOLDER"],
        ["new", "NOTHING/study.py"],
    ],
    ids=" ".join,
)
def test_every_other_file_and_folder_too(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "FILE").write_text("x\n")
    (tmp_path / "FOLDER").mkdir()
    assert main(words) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert any(place in said for place in ("NOTHING", "FILE", "FOLDER"))


@pytest.mark.parametrize(
    ("causes", "status", "text"),
    [
        ([InputError("imu.csv, line 7: expected")] * 3, 2, "celnav: imu.csv, line 7: expected\n"),
        ([InputError("a.mat: no"), InputError("b.mat: no")], 1, "celnav: 3 units are not done"),
        ([ArithmeticError("it fails")] * 3, 1, "celnav: 3 units are not done"),
        ([], 1, "celnav: 3 units are not done"),
    ],
)
def test_a_damaged_file_that_all_units_read_is_said_once(
    causes, status, text, tmp_path, monkeypatch, capsys
):
    def compute(*_arguments):
        raise UnfinishedError("3 units are not done: ins: rest (...)", causes)

    for name in ("imu_1.csv", "imu_1.csv.tag", "gnss_1.pos"):
        (tmp_path / name).write_text("x")
    monkeypatch.setattr(reproduce, "compute", compute)
    words = ["reproduce", "ins", "--ins", str(tmp_path), "--out", str(tmp_path / "out")]
    assert main(words) == status
    assert text in capsys.readouterr().err
