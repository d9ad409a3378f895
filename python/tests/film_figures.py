"""How exact the angle of a film is: the table of docs/benchmarks/film.md. ``python3 -m tests.film_figures`` in python."""

import sys
import tempfile
from pathlib import Path

import numpy as np

from .clips import Clip, errors_deg, follow
from .test_film import sine

LARGE = {"size": (640, 480), "fps": 240.0, "seconds": 1.0}
CLIPS = [
    ("sharp, lossless", Clip(sine(), crf=0, **LARGE), 0.02),  # type: ignore[arg-type]
    ("half-frame blur, noise 3 of 255, crf 18", Clip(sine(), crf=18, shutter=0.5, noise=3.0, **LARGE), 0.04),  # type: ignore[arg-type]
    ("half-frame blur, noise 6 of 255, crf 28", Clip(sine(), crf=28, shutter=0.5, noise=6.0, **LARGE), 0.08),  # type: ignore[arg-type]
]


def main() -> int:
    print("A wheel that makes 1 turn there and back in 1 s; marks 277 pixels apart; 640 × 480 pixels, 240 frames a second.\n")
    print("| clip | rms error, ° | largest error, ° | σ that the tracker states, ° | bound on the rms, ° |")
    print("|---|---|---|---|---|")
    broken = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, clip, bound in CLIPS:
            video = clip.write(Path(folder) / "clip.mp4")
            track = follow(video, sys.executable, exposure_s=clip.shutter / clip.fps)
            off, sigma = errors_deg(clip, track)
            rms = float(np.sqrt(np.mean(off**2)))
            broken += rms > bound
            print(f"| {name} | {rms:.4f} | {np.abs(off).max():.4f} | {np.median(sigma):.4f} | {bound} |", flush=True)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
