"""The example of docs/film.md: renders its clip, prints what the program says of it, and draws docs/img/film.svg.
``PULSETRAIN=../target/release/pulsetrain python3 -m tests.film_example`` in python."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from .clips import Clip
from .test_film import LAW, wheel
from .virtual import pulsetrain

PICTURE = Path(__file__).parents[2] / "docs/img/film.svg"
CLIP = Clip(
    wheel(lost=((0.3, 8),)),
    size=(640, 480),
    fps=240.0,
    seconds=1.2,
    shutter=0.5,
    noise=4.0,
    crf=23,
    repeated=(140,),
)


def main() -> int:
    program = str(Path(pulsetrain() or "").resolve())
    environment = {**os.environ, "PULSETRAIN_PYTHON": sys.executable}
    with tempfile.TemporaryDirectory() as folder:
        CLIP.write(Path(folder) / "clip.mp4")
        (Path(folder) / "wheel.toml").write_text(LAW)
        ran = subprocess.run([program, "film", "clip.mp4", "wheel.toml"], cwd=folder, env=environment)
        shutil.copy(Path(folder) / "out/clip/film.svg", PICTURE)
    # The lost steps are found.
    return 0 if ran.returncode == 1 else 1


if __name__ == "__main__":
    sys.exit(main())
