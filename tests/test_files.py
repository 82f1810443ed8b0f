"""Files are complete, replace only celnav's files, and are never executed."""

from __future__ import annotations

import errno
import json
import os
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from celnav import cli
from celnav.files import ForeignFileError, InputError, Outputs, npz, read_npz, replacing, write_text
from celnav.show.claims import Ledger, dumps, read_claims
from celnav.study.ledger import Number, Row


class Payload:
    def __reduce__(self):
        return (exec, ("raise SystemExit('run')",))


def test_an_npz_with_a_payload_raises_and_does_not_run(tmp_path):
    np.savez(tmp_path / "bad.npz", x=np.array([Payload()], dtype=object))
    with pytest.raises(ValueError, match=r"bad\.npz"):
        read_npz(tmp_path / "bad.npz")


def test_a_truncated_npz_is_named(tmp_path):
    outputs = Outputs(tmp_path)
    outputs.bytes("good.npz", npz({"x": np.arange(1000.0)}))
    np.testing.assert_array_equal(read_npz(tmp_path / "good.npz")["x"], np.arange(1000.0))
    (tmp_path / "cut.npz").write_bytes((tmp_path / "good.npz").read_bytes()[:200])
    with pytest.raises(ValueError, match=r"cut\.npz"):
        read_npz(tmp_path / "cut.npz")


def test_a_file_changed_by_somebody_is_refused(tmp_path):
    outputs = Outputs(tmp_path)
    outputs.text("a.txt", "one")
    outputs.text("a.txt", "two")
    assert Outputs(tmp_path).directory == tmp_path
    Outputs(tmp_path).text("a.txt", "three")
    (tmp_path / "a.txt").write_text("mine")
    with pytest.raises(ForeignFileError, match=r"a\.txt"):
        Outputs(tmp_path).check(["a.txt"])


@pytest.mark.parametrize("name", ["../x", "a/../../x", "/x"])
def test_names_do_not_leave_the_folder(tmp_path, name):
    with pytest.raises(ValueError, match=r"^name"):
        Outputs(tmp_path).text(name, "")


def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path):
    outputs = Outputs(tmp_path)
    outputs.text("a.txt", "old")

    def interrupted():
        with outputs.path_for("a.txt") as path:
            path.write_text("half")
            raise KeyboardInterrupt("while it writes")

    with pytest.raises(KeyboardInterrupt, match=r"^while it writes$"):
        interrupted()
    assert (tmp_path / "a.txt").read_text() == "old"
    assert {p.name for p in tmp_path.iterdir()} == {"a.txt", ".celnav.json"}
    outputs.text("a.txt", "new")


def test_text_is_written_in_utf8(tmp_path):
    write_text(tmp_path / "σ.txt", "±3σ")
    assert (tmp_path / "σ.txt").read_bytes().decode() == "±3σ"


def claim(id="one", value=1.0, kind="statement", **more):
    return Row(
        kind, id, "It is so", lambda _: Number("x", value, (None, 1.5), (0.5, 1.2)), **more
    ).judged(None)


def test_claims_can_be_read_again(tmp_path):
    write_text(
        tmp_path / "claims.json", dumps([claim(), claim("other", float("nan"), printed=[1.0, "a"])])
    )
    first, second = read_claims(tmp_path / "claims.json")
    assert (first["value"], first["verdict"]) == (1.0, "reproduced")
    assert (second["value"], second["verdict"], second["printed"]) == (
        None,
        "no number",
        [1.0, "a"],
    )
    for other in ("{}", '{"claims": []}', '{"schema": "urn:celnav:claims:1.0"}', "[]"):
        write_text(tmp_path / "bad.json", other)
        with pytest.raises(InputError, match=r"bad\.json: expected a table with schema 'urn:"):
            read_claims(tmp_path / "bad.json")
    write_text(tmp_path / "bad.json", '{"schema": "urn:celnav:claims:1.0", "claims": [{}]}')
    with pytest.raises(InputError, match=r"bad\.json: claim 0: id: not what celnav writes"):
        read_claims(tmp_path / "bad.json")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(
            (key, None)
            for key in (
                "id",
                "kind",
                "place",
                "statement",
                "accept",
                "expected",
                "verdict",
                "note",
                "numbers",
            )
        ),
        ("verdict", "well"),
        ("verdict", []),
        ("kind", {}),
        ("value", "x"),
        ("value", True),
        ("ci", [1.0]),
        ("ci", 3),
        ("ci", [1.2, 0.5]),
        ("accept", [1, "x"]),
        ("holds", 3),
        ("expected", True),
        ("numbers", [3]),
        ("numbers", [{"label": "x", "value": "y", "accept": [None, None], "ci": None}]),
        ("id", ...),
        ("ci", ...),
    ],
)
def test_a_claim_that_is_not_whole_is_named(tmp_path, key, value):
    document = json.loads(dumps([claim(), claim("other", kind="finding", printed="12 %")]))
    claims = document["claims"]
    write_text(tmp_path / "claims.json", json.dumps(document))
    assert read_claims(tmp_path / "claims.json") == claims
    claims[1][key] = value
    if value is ...:
        del claims[1][key]
    write_text(tmp_path / "claims.json", json.dumps(document))
    with pytest.raises(InputError, match=rf"claims\.json: claim 1: {key}: not what celnav writes"):
        read_claims(tmp_path / "claims.json")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[" * 100_000,
        "[3]",
        "3",
        "\x00",
        '[{"id": "a", "verdict": "shown"}]',
    ],
)
def test_damaged_files_of_celnav_are_one_line(tmp_path, capsys, text):
    """Damaged claims, time records and manifests."""
    folder = tmp_path / "csrukf"
    folder.mkdir()
    (folder / "claims.json").write_text(text)
    (folder / "timings.json").write_text(text)
    assert cli.main(["verdicts", "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert str(folder / "claims.json") in error
    assert error.count("\n") == 1
    (folder / "claims.json").write_text(dumps([claim()]))
    (folder / "checks.json").write_text(dumps([]))
    assert cli.main(["verdicts", "--out", str(tmp_path)]) == 0
    capsys.readouterr()
    (folder / ".celnav.json").write_text(text)
    assert cli.main(["reproduce", "csrukf", "--out", str(tmp_path)]) == 2
    assert (
        capsys.readouterr().err == f"celnav: {folder / '.celnav.json'}: not a manifest of celnav\n"
    )


def test_a_ledger_shows_itself_everywhere():
    table = Ledger([claim(found="x < {0:.0f}"), claim("other", kind="erratum")])
    assert "x &lt; 1 [0, 1]" in table._repr_html_()
    assert table._repr_html_().count('href="#say-') == 1
    assert str(table).count("reproduced") == 1
    assert table._repr_markdown_().count("\n") == 2


def test_an_archive_that_unpacks_to_very_much_is_refused(tmp_path):
    path = tmp_path / "bomb.npz"
    np.savez_compressed(path, a=np.zeros(10_000_000))
    with pytest.raises(
        ValueError, match=r"bomb\.npz: .*unpacks to 80000\d+ bytes, more than 100 times its size"
    ):
        read_npz(path)


@contextmanager
def limited(size):
    """Limit the size of this process's files, as with ``ulimit -f``."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("name", ["a.txt", "a.npz"])
def test_a_file_beyond_the_limit_of_size_is_named_and_the_old_one_stays(tmp_path, name):
    outputs = Outputs(tmp_path)
    large = np.zeros(100_000)
    outputs.text(name, "old")
    with (
        limited(50_000),
        pytest.raises(OSError, match=r"larger than the limit of file sizes.*ulimit -f") as caught,
    ):
        outputs.publish({name: npz({"a": large}) if name == "a.npz" else "a" * 100_000})
    assert caught.value.filename == str(tmp_path / name)
    assert {path.name for path in tmp_path.iterdir()} == {name, ".celnav.json"}
    assert (tmp_path / name).read_text() == "old"
    Outputs(tmp_path).check([name])


def test_a_manifest_that_cannot_be_written_is_named_itself(tmp_path):
    outputs = Outputs(tmp_path)
    for k in range(60):
        outputs.text(f"{k}.txt", "")
    with limited(1000), pytest.raises(OSError, match="limit of file sizes") as caught:
        outputs.text("new.txt", "")
    assert caught.value.filename == str(tmp_path / ".celnav.json")
    assert not (tmp_path / "new.txt").exists()


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOSPC, "no space left to write the file; free some, or choose another disk"),
        (errno.EDQUOT, "the disk quota is used up; free some space, or choose another disk"),
        (errno.EIO, os.strerror(errno.EIO)),
    ],
)
def test_what_hinders_a_write_is_said_of_the_file(tmp_path, number, words):
    with pytest.raises(OSError) as caught, replacing(tmp_path / "a.txt"):
        raise OSError(number, os.strerror(number))
    assert (caught.value.strerror, caught.value.filename) == (words, str(tmp_path / "a.txt"))
    with pytest.raises(OSError, match="No such file") as caught, replacing(tmp_path / "a.txt"):
        (tmp_path / "other").read_text()
    assert caught.value.filename == str(tmp_path / "other")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_device_that_is_full_is_named():
    with pytest.raises(OSError, match="no space left to write the file") as caught:
        write_text("/dev/full", "text")
    assert caught.value.filename == "/dev/full"


def test_two_that_write_into_a_folder_know_of_each_other(tmp_path):
    one, other = Outputs(tmp_path), Outputs(tmp_path)
    other.text("a.txt", "theirs")
    one.text("a.txt", "ours")
    other.text("b.txt", "theirs")
    Outputs(tmp_path).check(["a.txt", "b.txt"])


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_what_is_no_file_is_written_to_and_stays(tmp_path):
    """A device such as /dev/null is not replaced by a file, even for root."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_text(pipe, "through")
    assert os.read(reader, 100) == b"through"
    os.close(reader)
    assert pipe.is_fifo()
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]
