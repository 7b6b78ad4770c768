"""Files and folders that are there whole or not at all.

What is new is made under a temporary name beside its place, `.NAME.PID.part`, and renamed at the end; a folder that stands there
is first put aside as `.NAME.PID.old`, for two folders cannot change places at once. A process that is killed can leave such
remains: whoever writes to the same place next removes those of dead processes, and puts back an old folder that was put aside
and never replaced.
"""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from millcal.errors import RecipeError, RecordingError


@contextmanager
def replaced_atomically(path: Path) -> Iterator[Path]:
    """A temporary path in the same folder, which becomes `path` when the block ends well and vanishes when it does not."""
    path = Path(path)
    temporary = _beside(path, "part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        tidy_remains(path)
        yield temporary
        _flush(temporary)
        os.replace(temporary, path)
        _flush(path.parent)
    except OSError as problem:
        raise RecordingError(
            f"{path}: cannot be written ({(problem.strerror or str(problem)).lower()}); "
            "choose another place or make room"
        ) from None
    finally:
        with suppress(OSError):
            temporary.unlink()


@contextmanager
def replaced_folder(out: Path) -> Iterator[Path]:
    """A new folder beside `out`, which takes its place when the block ends well and vanishes when it does not."""
    out = Path(os.path.realpath(out))  # a link keeps pointing here
    aside, folder = _beside(out, "old"), _beside(out, "part")
    try:
        tidy_remains(out)
        folder.mkdir(parents=True)
        yield folder
        if out.exists():
            os.replace(out, aside)
        os.replace(folder, out)
    except OSError as problem:
        raise RecipeError(
            f"{out}: cannot be written ({(problem.strerror or str(problem)).lower()}); choose another place"
        ) from None
    finally:
        if aside.exists() and not out.exists():
            os.replace(aside, out)
        for left in (folder, aside):
            shutil.rmtree(left, ignore_errors=True)


def tidy_remains(path: Path) -> None:
    """Put back an old folder that a killed process had put aside, and remove what else dead processes left beside `path`."""
    with suppress(OSError):  # what forbids to tidy forbids to write, and is told then
        for left in _remains(path, "old"):
            if not os.path.lexists(path):
                os.replace(left, path)
        for left in (*_remains(path, "old"), *_remains(path, "part")):
            if left.is_dir():
                shutil.rmtree(left, ignore_errors=True)
            else:
                left.unlink(missing_ok=True)


def _beside(path: Path, kind: str) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}.{kind}")


def _remains(path: Path, kind: str) -> list[Path]:
    """The remains of dead processes at a place, the newest first."""
    start, end = f".{path.name}.", f".{kind}"
    if not path.parent.is_dir():
        return []
    found = [
        left
        for left in path.parent.iterdir()
        if left.name.startswith(start) and left.name.endswith(end) and _is_dead(left.name[len(start) : -len(end)])
    ]
    return sorted(found, key=lambda left: left.stat().st_mtime, reverse=True)


def _is_dead(pid: str) -> bool:
    """Whether no process of this number is at work; one of our own number that is met was another's, before us."""
    if not (pid.isascii() and pid.isdigit()):
        return False
    if int(pid) == os.getpid():
        return True
    try:
        os.kill(int(pid), 0)
    except (ProcessLookupError, OverflowError):
        return True
    except PermissionError:
        return False
    return False


def _flush(path: Path) -> None:
    """Have the disk hold what was written to a file, or which names a folder holds."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_folder(out: Path, is_ours: Callable[[str], bool], what: str) -> None:
    """Refuse to replace what is no folder of ours, or holds anything besides.

    is_ours : whether a file of this name is part of what is replaced   what : its name in the message
    """
    if not os.path.lexists(out):
        return
    if not out.is_dir():
        raise RecipeError(f"{out}: is a file; name a folder for the {what}")
    foreign = sorted(path.name for path in out.iterdir() if not is_ours(path.name))
    if foreign:
        raise RecipeError(
            f"{out}: holds {foreign[0]}, which is no part of a {what} and would be lost; "
            "move it away or choose another folder"
        )
