"""Two machines on one file system never both make a version, whether or not each sees the other's locks."""

from __future__ import annotations

import fcntl
from pathlib import Path

import pytest

from pipeline.engine.dataset import Dataset, presence
from pipeline.errors import UserError


@pytest.fixture(autouse=True)
def hurried(monkeypatch):
    for name, seconds in {"BEAT_S": 0.02, "LOOK_S": 0.02, "SILENT_S": 0.3}.items():
        monkeypatch.setattr(presence, name, seconds)


@pytest.fixture
def on(monkeypatch):
    """on(NAME): what follows happens on the machine of that name."""
    return lambda name: monkeypatch.setattr(presence, "machine", lambda: name)


@pytest.fixture
def locks_of_its_own(monkeypatch):
    """A file system that grants every lock."""
    monkeypatch.setattr(fcntl, "flock", lambda handle, how: None)


def records(dataset: Dataset) -> list[Path]:
    return list((dataset.root / ".work" / presence.FOLDER).iterdir())


@pytest.fixture
def dataset(tmp_path) -> Dataset:
    made = Dataset(tmp_path / "d")
    made.prepare()
    return made


def test_a_second_machine_that_does_not_see_the_first_ones_locks_is_refused_in_one_line(dataset, on, locks_of_its_own):
    on("one")
    with dataset.in_use():
        on("two")
        with (
            pytest.raises(UserError, match=r"another machine.*is at work.*locks.*do not reach.*flock") as caught,
            dataset.in_use(),
        ):
            pytest.fail("two machines are at work")
        assert "\n" not in str(caught.value)
        on("one")
    on("two")
    with dataset.in_use():
        assert len(records(dataset)) == 1
    assert not records(dataset)


def test_of_two_machines_that_come_at_once_no_two_begin(dataset, on, locks_of_its_own, monkeypatch):
    """The second comes while the first has left its record and not looked about yet."""
    refused = []
    look = presence._refuse_unreached

    def interrupted(found, root, say):
        monkeypatch.setattr(presence, "_refuse_unreached", look)
        on("two")
        with pytest.raises(UserError), dataset.in_use():
            pytest.fail("two machines are at work")
        refused.append("two")
        on("one")
        look(found, root, say)

    monkeypatch.setattr(presence, "_refuse_unreached", interrupted)
    on("one")
    with dataset.in_use():
        assert refused == ["two"]


def test_machines_that_see_each_others_locks_share_a_dataset(dataset, on):
    on("one")
    with dataset.in_use():
        on("two")
        with dataset.in_use(), dataset.in_use():
            assert len(records(dataset)) == 3


def test_what_a_run_left_that_died_is_dropped_after_a_look(dataset, on, capsys):
    on("one")
    with dataset.in_use():
        left = [p.with_name(p.name.replace("one", name)) for p in records(dataset) for name in ("two", "one-9")]
        for path in left:
            path.write_text("far 0000000003\n")
    with dataset.in_use():
        assert len(records(dataset)) == 1
    said = capsys.readouterr().out
    assert "another machine (far) was at work here" in said and said.count("\n") == 1


def test_a_record_that_is_a_link_or_a_pipe_is_not_followed(dataset, tmp_path, on):
    on("one")
    outside = tmp_path / "outside"
    outside.write_text("keep")
    (dataset.root / ".work" / presence.FOLDER).mkdir()
    (dataset.root / ".work" / presence.FOLDER / "two-1-0").symlink_to(outside)
    with pytest.raises(UserError, match="is no plain file"), dataset.in_use():
        pass
    assert outside.read_text() == "keep"


def test_the_number_of_a_run_goes_up_as_long_as_it_lives(dataset, on):
    import time

    on("one")
    with dataset.in_use():
        (record,) = records(dataset)
        before, deadline = record.read_text(), time.monotonic() + 5
        while record.read_text() == before and time.monotonic() < deadline:
            time.sleep(0.01)
        assert record.read_text() > before
    assert not presence.BEATS._numbers
