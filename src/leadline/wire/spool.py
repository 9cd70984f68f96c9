"""A file that grows by whole blocks: what is written stays whole, is synced twice a second, and a full disk is told."""

from __future__ import annotations

import errno
import os
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path

SYNC_S = 0.5  # half of what a power cut may cost


class Spool:
    """A block that finds no room is kept, and tried again with the next one: nothing is lost until ``keep_bytes`` wait.

    ``tick`` is called twice a second, by the thread that syncs: for a block that should not wait any longer.
    """

    def __init__(
        self,
        path: Path,
        *,
        keep_bytes: int = 64 * 2**20,
        tick: Callable[[], None] = lambda: None,
        sync_s: float = SYNC_S,
    ) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path, self.lost = path, 0
        self._keep_bytes, self._tick, self._sync_s = keep_bytes, tick, sync_s
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o666)
        self._size = self._synced = 0  # bytes of whole blocks; of those that are safe from a power cut
        self._last = b""  # the latest block in the file
        self._waiting: deque[bytes] = deque()
        self._write_error: OSError | None = None
        self._sync_error: OSError | None = None
        self._writing = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._sync_loop, name=f"sync {path.name}", daemon=True)
        self._thread.start()

    @property
    def closed(self) -> bool:
        return self._file < 0

    @property
    def written(self) -> tuple[int, bytes]:
        """Bytes of whole blocks in the file, and the last of these blocks: for reading it back."""
        return self._size, self._last

    @property
    def error(self) -> OSError | None:
        """While the disk does not take what it is given: why."""
        found = self._write_error or self._sync_error
        if found is None:
            return None
        return OSError(found.errno, os.strerror(found.errno or errno.EIO), str(self.path))

    def append(self, block: bytes) -> None:
        """Raises OSError while the disk does not take what it is given."""
        with self._writing:
            self._write_waiting()
            if self._waiting and sum(map(len, self._waiting)) + len(block) > self._keep_bytes:
                self.lost += 1
            else:
                self._waiting.append(block)
                self._write_waiting()
        if self.error is not None:
            raise self.error

    def close(self, tail: Callable[[], bytes] | None = None) -> None:
        """Write what waits and then ``tail()``, sync, close. Raises OSError for what could not be written."""
        if self.closed:
            return
        self._closing.set()
        self._thread.join()
        try:
            self._write_waiting()
            if self._write_error is None and tail is not None:
                self._waiting.append(tail())
                self._write_waiting()
            os.fsync(self._file)
            self._sync_error = None
            if self.error is not None:
                raise self.error
        finally:
            os.close(self._file)
            self._file = -1

    def _write_waiting(self) -> None:
        try:
            while self._waiting:
                self._write(self._waiting[0])
                self._waiting.popleft()
            self._write_error = None
        except OSError as error:
            self._write_error = error

    def _write(self, block: bytes) -> None:
        """The whole block, or nothing of it."""
        done = 0
        try:
            while done < len(block):
                done += os.pwrite(self._file, memoryview(block)[done:], self._size + done)
        except OSError:
            os.ftruncate(self._file, self._size)
            raise
        self._size += len(block)
        self._last = block

    def _sync_loop(self) -> None:
        while not self._closing.wait(self._sync_s):
            try:
                self._tick()
                size = self._size
                if size != self._synced:
                    os.fsync(self._file)
                    self._synced = size
                self._sync_error = None
            except OSError as error:
                self._sync_error = error
