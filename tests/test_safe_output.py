"""Nothing is half-written, and nothing that is not ours is replaced."""

import stat
from pathlib import Path

import pytest

from layerfield.io import whole_directory, whole_file


def names(folder):
    return [entry.name for entry in folder.iterdir()]


def test_whole_file(tmp_path):
    path = tmp_path / "a.txt"
    with whole_file(path) as temporary:
        temporary.write_text("new")
        assert temporary.suffix == ".txt"
        assert not path.exists()
    assert path.read_text() == "new"
    with pytest.raises(ValueError, match="exists"), whole_file(path):
        pass
    with whole_file(path, force=True) as temporary:
        temporary.write_text("newer")
    assert path.read_text() == "newer"
    assert names(tmp_path) == ["a.txt"]
    assert stat.S_IMODE(path.stat().st_mode) & 0o600 == 0o600


@pytest.mark.parametrize("make", [whole_file, whole_directory])
@pytest.mark.parametrize("problem", [KeyboardInterrupt, RuntimeError, SystemExit])
def test_nothing_is_left_after_an_exception(tmp_path, make, problem):
    with pytest.raises(problem), make(tmp_path / "a"):
        raise problem
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("make", [whole_file, whole_directory])
def test_system_errors_become_one_line(tmp_path, make):
    with pytest.raises(ValueError, match=r"cannot write .*No space left"), make(tmp_path / "a"):
        raise OSError(28, "No space left on device")
    with pytest.raises(ValueError, match="does not exist"), make(tmp_path / "b" / "a"):
        pass
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="is not a folder"), make(tmp_path / "file" / "a"):
        pass
    for nameless in ("", ".", "..", "/"):
        with pytest.raises(ValueError, match="cannot write"), make(nameless, force=True):
            pass


def test_whole_directory(tmp_path):
    path = tmp_path / "out"
    with whole_directory(path) as temporary:
        (temporary / "result.json").write_text("1")
        assert not path.exists()
    with pytest.raises(ValueError, match="exists"), whole_directory(path):
        pass
    with pytest.raises(RuntimeError), whole_directory(path, force=True) as temporary:
        (temporary / "result.json").write_text("2")
        raise RuntimeError
    assert (path / "result.json").read_text() == "1"
    with whole_directory(path, force=True) as temporary:
        (temporary / "display.toml").write_text("3")
    assert names(path) == ["display.toml"]
    assert names(tmp_path) == ["out"]


def test_foreign_folders_are_never_replaced(tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    (home / "letters.txt").touch()
    with pytest.raises(ValueError, match="was not made here"), whole_directory(home, force=True):
        pass
    with pytest.raises(ValueError, match="is a folder"), whole_file(home, force=True):
        pass
    letters = home / "letters.txt"
    with pytest.raises(ValueError, match="is a file"), whole_directory(letters, force=True):
        pass
    assert (home / "letters.txt").exists()


def test_a_failed_replacement_restores_the_old_folder(tmp_path, monkeypatch):
    path = tmp_path / "out"
    path.mkdir()
    (path / "result.json").write_text("old")
    rename = Path.rename

    def fail_for_the_new_one(self, target):
        if target == path and not (self / "result.json").exists():
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fail_for_the_new_one)
    with pytest.raises(ValueError, match="Input/output"), whole_directory(path, force=True):
        pass
    assert (path / "result.json").read_text() == "old"
    assert names(tmp_path) == ["out"]
