"""Virtual boards at the ends of pseudo-terminals."""

import importlib.util
import os
import subprocess
import tempfile
import unittest
from pathlib import Path
from typing import Optional


def pulsetrain() -> Optional[str]:
    """The program that runs a virtual board: the one in ``PULSETRAIN``, else the debug build, else the release build."""
    target = Path(__file__).resolve().parents[3] / "target"
    known = [os.environ.get("PULSETRAIN"), str(target / "debug/pulsetrain"), str(target / "release/pulsetrain")]
    return next((path for path in known if path and Path(path).exists()), None)


#: Marks tests that use pseudo-terminals.
needs_pty = unittest.skipUnless(
    importlib.util.find_spec("serial") and hasattr(os, "openpty"), "needs pyserial and a pty"
)
#: Marks tests that use virtual boards.
needs_boards = unittest.skipUnless(
    importlib.util.find_spec("serial") and hasattr(os, "openpty") and pulsetrain(),
    "needs pyserial, a pty, and pulsetrain: cargo build, or PULSETRAIN=…",
)


#: Marks tests that only `cargo xtask soak` runs.
long = unittest.skipUnless(os.environ.get("PULSETRAIN_LONG"), "long: cargo xtask soak, or PULSETRAIN_LONG=1")


class VirtualBoard:
    """Runs `pulsetrain board BOARD --pty`, in real time if the computer is fast enough, until the block ends."""

    def __init__(self, board: str) -> None:
        self.folder = tempfile.TemporaryDirectory()
        self.port = str(Path(self.folder.name) / "port")
        command = [pulsetrain() or "", "board", board, "--pty", self.port]
        if board == "uno":
            command += ["--image", "winch"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.process.stdout.readline()

    def __enter__(self) -> str:
        return self.port

    def __exit__(self, *_: object) -> None:
        self.process.terminate()
        self.process.communicate()
        self.folder.cleanup()
