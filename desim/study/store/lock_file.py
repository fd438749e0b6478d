"""A lock among processes of several hosts that share a folder: a file that names its holder, which rewrites it often.

A lock file works where locks of the operating system do not, because creating a link is atomic on every network file
system. It is stale if its time is more than `STALE` seconds old, and its holder does not rewrite it while it is watched
for `WATCH` seconds: some file systems (Lustre, GPFS, Ceph, AFS) record the time of the host that writes, and the clocks
of two hosts may differ. A holder whose process is gone has ended, but this can be told only on its own host, in its own
namespace of processes.
"""

import json
import os
import socket
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Self

from desim.config.whole_files import open_no_link

HEARTBEAT = 5.0
"""The interval, s of wall time, at which a holder rewrites its lock file."""
STALE = 120.0
"""The age, s, from which a lock file is stale; well above a minute, because NFS may show times that are so old."""
WATCH = 3 * HEARTBEAT
"""For how long a stale lock of another host is watched, s of wall time, before it is removed."""
LONGEST = 65_536
"""The number of bytes that are read of a lock file; its own text is shorter."""
PAUSE = 0.1
"""The interval, s of wall time, between two attempts to get a lock."""


class LockedError(OSError):
    """Raised when another process holds a lock; the message names the process and its host."""


@dataclass(frozen=True, slots=True)
class Holder:
    """The process that holds a lock, as its lock file says."""

    host: str
    place: str
    """Identifies the host, its last start, and the namespace of processes; see `place`."""
    pid: int
    token: str
    """Identifies the lock: a process that gets it again has another token."""
    age: float = 0.0
    """The time since the holder last rewrote the file, s by the times of the files."""
    content: bytes = b""
    """The text of the file, which each sign of life changes."""

    def has_ended(self) -> bool:
        """Return whether the process is known to have ended."""
        return self.place == place() and not _runs(self.pid)

    def __str__(self) -> str:
        who = f"process {self.pid} on {self.host}" if self.pid else "an unknown process"
        return f"{who}, whose last sign of life is {max(self.age, 0.0):.0f} s old"


class LockFile:
    """A lock that at most one process holds among all that use the same path.

    Args:
        path: the path of the lock file; its folder must exist.
    """

    def __init__(self, path: Path):
        self.path = path
        self._token = uuid.uuid4().hex
        self._beats, self._file = 0, -1
        self._ended = threading.Event()
        self._rewriting = threading.Lock()

    def acquire(self, patience: float, on_wait: Callable[[Holder], None] = lambda _: None) -> Self:
        """Wait for the lock, and get it; `on_wait` is called once if another process holds the lock.

        A holder that shows no sign of life is waited for until its lock is stale, so that work resumes on another host.

        Raises:
            LockedError: if the holder is alive after `patience` s of wall time, or is this process.
        """
        start = last_sign = time.monotonic()
        last_content: bytes | None = None
        while (holder := self.try_acquire()) is not None:
            if (holder.place, holder.pid) == (place(), os.getpid()):
                raise LockedError("this process uses it already")
            now = time.monotonic()
            if last_content is None:
                on_wait(holder)
            if holder.content != last_content:
                last_content, last_sign = holder.content, now
            if now - last_sign > STALE:  # by the clock of this host: the time of the file may lie ahead
                self._remove(holder)
            elif now - start > patience and now - last_sign < WATCH:  # alive: a silent holder may soon be stale
                raise LockedError(f"{holder}, uses it")
            else:
                time.sleep(PAUSE)
        return self

    def try_acquire(self) -> Holder | None:
        """Get the lock and return None, or return the process that holds it.

        It returns at once, unless it has to watch a stale lock of another host first.
        """
        draft = self.path.with_name(f".{self.path.name}.{self._token}")
        file = os.open(draft, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        try:
            while True:
                _rewrite(file, self._content())
                if (lock := _published(draft, file, self.path)) >= 0:
                    self._hold(lock)
                    return None
                if (holder := _holder(self.path, os.fstat(file).st_mtime)) is None:
                    continue  # it was released meanwhile
                if not holder.has_ended():
                    if holder.age <= STALE:
                        return holder
                    if (alive := self._sign_of_life(holder)) is not None:
                        return alive
                self._remove(holder)
        finally:
            draft.unlink(missing_ok=True)
            os.close(file)

    def _content(self) -> bytes:
        """Return the text of the lock file; its length is fixed, so that no part of the old text outlasts a rewrite."""
        fields = {"host": socket.gethostname(), "place": place(), "pid": os.getpid(), "token": self._token}
        return f"{json.dumps(fields | {'beat': f'{self._beats:010}'})}\n".encode()

    def _hold(self, file: int) -> None:
        self._file = file
        _rewrite(file, self._content())  # on a file system without links the file is still empty
        self._ended.clear()
        threading.Thread(target=self._beat, daemon=True).start()

    def _beat(self) -> None:
        while not self._ended.wait(HEARTBEAT):
            self._beats += 1
            with suppress(OSError), self._rewriting:  # if the lock is lost, `is_held` says so
                if not self._ended.is_set():
                    _rewrite(self._file, self._content())

    def _sign_of_life(self, holder: Holder) -> Holder | None:
        """Return the holder of a stale lock if it rewrites its file while it is watched; otherwise None."""
        end = time.monotonic() + WATCH
        while time.monotonic() < end:
            time.sleep(PAUSE)
            current = _holder(self.path, 0.0)
            if current is None:
                return None
            if current.content != holder.content:
                return replace(current, age=0.0)
        return None

    def _remove(self, holder: Holder) -> None:
        """Remove a stale lock; if another process has just replaced it by a lock of its own, put that back."""
        aside = self.path.with_name(f".{self.path.name}.{self._token}.stale")
        with suppress(FileNotFoundError):
            self.path.rename(aside)
            if (taken := _holder(aside, 0.0)) is not None and taken.token != holder.token:
                with suppress(OSError):
                    os.link(aside, self.path)
            aside.unlink()

    def is_held(self) -> bool:
        """Return whether this object holds the lock; False if another process took it for dead."""
        return self._file >= 0 and (holder := _holder(self.path, 0.0)) is not None and holder.token == self._token

    def release(self) -> None:
        """Release the lock if it is held."""
        if self._file < 0:
            return
        self._ended.set()
        with self._rewriting:  # the number of a closed file soon belongs to another one
            if self.is_held():
                self.path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = -1


def _rewrite(file: int, content: bytes) -> None:
    """Write the content of a lock file, whose time is then that of the file server."""
    os.lseek(file, 0, os.SEEK_SET)
    os.write(file, content)
    os.fsync(file)


def _published(draft: Path, file: int, path: Path) -> int:
    """Give a draft the path of the lock, and return a descriptor of the lock file; -1 if there is a lock already.

    The answer of an NFS server to a link can be lost. The repeated request then fails although the link exists, so the
    count of links decides. Without links, the lock file is created exclusively instead, which SMB and FUSE do right.
    """
    try:
        os.link(draft, path)
    except FileExistsError:
        return os.dup(file) if os.fstat(file).st_nlink == 2 else -1
    except OSError:
        try:
            return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            return -1
    return os.dup(file)


def _holder(path: Path, now: float) -> Holder | None:
    """Return the holder that a lock file names; None if there is no file.

    Opening the file makes NFS ask the server for its time. A file without a holder was just made, or its maker died.
    """
    try:
        # No symbolic link is followed: with a broken one, `os.link` fails and a reader finds no file, again and again.
        with open(path, "rb", opener=open_no_link) as stream:
            age, text = now - os.fstat(stream.fileno()).st_mtime, stream.read(LONGEST)
    except FileNotFoundError:
        return None
    try:
        fields = json.loads(text)
        return Holder(str(fields["host"]), str(fields["place"]), int(fields["pid"]), str(fields["token"]), age, text)
    except (ValueError, KeyError, TypeError, RecursionError):
        return Holder("", "", 0, "", age, text)


@cache
def place() -> str:
    """Return a text that two processes share only if their process numbers mean the same: host, start, namespace."""
    parts = [socket.gethostname()]
    with suppress(OSError):
        parts.append(Path("/proc/sys/kernel/random/boot_id").read_text().strip())
        parts.append(str(Path("/proc/self/ns/pid").readlink()))
    return " ".join(parts)


def _runs(pid: int) -> bool:
    """Return whether a process of this host runs; a zombie does not."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in {"Z", "X"}
    if os.name != "posix":  # on Windows, `os.kill` would end the process
        return True
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):  # OverflowError: no process has such a number
        return False
    except OSError:  # of another user
        return True
    return True
