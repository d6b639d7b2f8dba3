"""A file that a user names is either written completely, or does not appear at all."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from petmjx.common.atomic_write import atomic_write
from petmjx.common.errors import InputError
from petmjx.packers.sample_plans import write_samples


def half_written(file: Path) -> None:
    with atomic_write(file) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt


def test_a_file_appears_when_it_is_whole_and_else_stays_as_it_was(tmp_path: Path) -> None:
    file = tmp_path / "plans.json"
    file.write_text("before")
    with pytest.raises(KeyboardInterrupt):
        half_written(file)
    assert file.read_text() == "before"
    with atomic_write(file) as temporary:
        assert temporary.suffix == ".json"
        temporary.write_text("after")
        assert file.read_text() == "before"
    assert file.read_text() == "after"
    assert list(tmp_path.iterdir()) == [file]


def test_a_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    real, link = tmp_path / "there" / "real.json", tmp_path / "link.json"
    link.symlink_to(real)
    for text in ("one", "two"):
        with atomic_write(link) as temporary:
            temporary.write_text(text)
        assert link.is_symlink()
        assert real.read_text() == text
    assert list(real.parent.iterdir()) == [real]


def test_what_is_no_file_is_written_to_and_stays(tmp_path: Path) -> None:
    fifo = tmp_path / "fifo.json"
    os.mkfifo(fifo)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(fifo.read_text()), daemon=True)
    reader.start()
    write_samples(fifo, 1, 0)
    reader.join(timeout=20)
    assert read[0].startswith('{\n"s0-000000": [')
    assert fifo.is_fifo()
    assert list(tmp_path.iterdir()) == [fifo]


def test_a_pipe_that_has_no_path_is_written_to() -> None:
    reader, writer = os.pipe()
    with atomic_write(Path(f"/dev/fd/{writer}")) as same:
        same.write_text("through")
    os.close(writer)
    with open(reader) as end:
        assert end.read() == "through"


def test_a_folder_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere/plans\.json: cannot be written: "):
        write_samples(tmp_path / "nowhere" / "plans.json", 1, 0)
    with pytest.raises(InputError, match="cannot be written: "), atomic_write(tmp_path) as same:
        same.write_text("")
