"""Clips of a turning wheel, rendered: with blur, noise, an oblique view, a rolling shutter, and frames that are missing.

The renderer knows nothing of the tracker: each pixel's place on the wheel comes from the homography, and a mark covers a
pixel by its distance from there. ffmpeg (Debian's) makes a video file of the frames.
"""

import json
import math
import shutil
import subprocess
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Callable, List, Optional, Sequence, Tuple

import numpy as np

#: Angle over time: s to rad.
Motion = Callable[[float], float]

HAS_FFMPEG = shutil.which("ffmpeg") is not None


@dataclass
class Spot:
    """A round mark on the wheel; radii are parts of the wheel's."""

    bgr: Tuple[int, int, int]
    at: float = 0.72
    radius: float = 0.09
    angle_deg: float = 0.0


RED = Spot((40, 40, 220))
BLUE = Spot((220, 90, 30), angle_deg=180.0)


@dataclass
class Clip:
    """How a clip looks."""

    motion: Motion
    size: Tuple[int, int] = (320, 240)
    fps: float = 120.0
    seconds: float = 1.0
    #: Part of a frame's time during which the shutter is open.
    shutter: float = 0.0
    #: Pictures that are averaged over the exposure.
    exposures: int = 6
    noise: float = 0.0
    crf: int = 12
    #: s from the first row to the last.
    readout_s: float = 0.0
    #: Turn of the camera about the picture's x and y axes, degrees; its distance in wheel radii.
    tilt_deg: Tuple[float, float] = (0.0, 0.0)
    distance: float = 6.0
    marks: Sequence[Spot] = (RED, BLUE)
    #: Half sides of the rectangle of marks on the frame, in wheel radii.
    frame: Optional[Tuple[float, float]] = None
    wheel_bgr: Tuple[int, int, int] = (190, 190, 190)
    behind_bgr: Tuple[int, int, int] = (60, 60, 60)
    #: Frames that are left out; their time stamps are, too.
    dropped: Sequence[int] = ()
    #: Frames that show the one before again.
    repeated: Sequence[int] = ()
    #: The camera's times of frames, s; without them they are even.
    times: Optional[Sequence[float]] = None
    #: What the header says of frames in a second, whatever the time stamps are.
    said_fps: Optional[float] = None
    #: How many times slower the file plays.
    slow: float = 1.0
    #: Frames in which the first mark is hidden.
    hidden: Sequence[int] = ()
    shake_px: float = 0.0
    seed: int = 1
    more_ffmpeg: Sequence[str] = field(default_factory=tuple)

    def frame_times(self) -> List[float]:
        """Start of each frame's exposure, s."""
        if self.times is not None:
            return list(self.times)
        return [i / self.fps for i in range(round(self.seconds * self.fps))]

    def middles(self) -> List[float]:
        """Middle of each frame's exposure at the first row, s, of the frames that are in the file."""
        half = 0.5 * self.shutter / self.fps
        return [t + half for i, t in enumerate(self.frame_times()) if i not in self.dropped]

    def homography(self) -> Any:
        """From the wheel's plane (radius 1, y upwards) to pixels."""
        w, h = self.size
        focal = 0.40 * h * self.distance
        about_x, about_y = (math.radians(a) for a in self.tilt_deg)
        rx = np.array([[1, 0, 0], [0, math.cos(about_x), -math.sin(about_x)], [0, math.sin(about_x), math.cos(about_x)]])
        ry = np.array([[math.cos(about_y), 0, math.sin(about_y)], [0, 1, 0], [-math.sin(about_y), 0, math.cos(about_y)]])
        turn = ry @ rx
        # Plane point (u, v, 0): camera sees turn·(u, -v, 0) + (0, 0, distance).
        columns = np.stack([turn[:, 0], -turn[:, 1], np.array([0.0, 0.0, self.distance])], axis=1)
        camera = np.array([[focal, 0, w / 2 + 3.3], [0, focal, h / 2 - 2.1], [0, 0, 1]])
        return camera @ columns

    def pictures(self) -> "Pictures":
        return Pictures(self)

    def write(self, path: Path) -> Path:
        """Makes the video file."""
        w, h = self.size
        times = [t for i, t in enumerate(self.frame_times()) if i not in self.dropped]
        even = self.times is None and not self.dropped and self.said_fps is None and self.slow == 1.0
        raw = ["-f", "rawvideo", "-pix_fmt", "bgr24", "-s", f"{w}x{h}"]
        code = ["-c:v", "libx264", "-preset", "veryfast", "-crf", str(self.crf), "-pix_fmt", "yuv420p", *self.more_ffmpeg]
        rate = str(self.fps) if even else "1000"
        command = ["ffmpeg", "-loglevel", "error", "-y", *raw, "-r", rate, "-i", "-"]
        if not even:
            # Time stamps as a table: the n-th frame's in µs.
            stamps = "+".join(f"eq(N,{n})*{round(t * self.slow * 1e6)}" for n, t in enumerate(times))
            command += ["-filter_script:v", str(path.with_suffix(".filter")), "-fps_mode", "passthrough"]
            path.with_suffix(".filter").write_text(f"settb=1/1000000,setpts='{nested(stamps)}'")
            command += ["-enc_time_base", "1/1000000", "-video_track_timescale", "1000000"]
        with tempfile.TemporaryFile() as errors:
            process = subprocess.Popen([*command, *code, str(path)], stdin=subprocess.PIPE, stderr=errors)
            assert process.stdin is not None
            for i, picture in enumerate(self.pictures()):
                if i not in self.dropped:
                    process.stdin.write(picture.tobytes())
            process.stdin.close()
            if process.wait() != 0:
                errors.seek(0)
                raise RuntimeError(errors.read().decode())
        if self.said_fps is not None:
            said = path.with_name("said" + path.suffix)
            header = ["ffmpeg", "-loglevel", "error", "-y", "-i", str(path), "-c", "copy"]
            subprocess.run([*header, "-r", str(self.said_fps), "-metadata", "comment=wrong rate", str(said)], check=True)
            said.replace(path)
        return path


def nested(sum_of_terms: str) -> str:
    """ffmpeg's expressions are read recursively: a long flat sum is put into groups."""
    terms = sum_of_terms.split("+")
    while len(terms) > 1:
        terms = ["(" + "+".join(terms[k : k + 16]) + ")" for k in range(0, len(terms), 16)]
    return terms[0]


class Pictures:
    """The frames of a clip, one after the other."""

    def __init__(self, clip: Clip) -> None:
        self.clip = clip
        w, h = clip.size
        self.matrix = clip.homography()
        inverse = np.linalg.inv(self.matrix)
        ys, xs = np.mgrid[0:h, 0:w].astype(np.float64)
        below = inverse[2, 0] * xs + inverse[2, 1] * ys + inverse[2, 2]
        self.u = ((inverse[0, 0] * xs + inverse[0, 1] * ys + inverse[0, 2]) / below).astype(np.float32)
        self.v = ((inverse[1, 0] * xs + inverse[1, 1] * ys + inverse[1, 2]) / below).astype(np.float32)
        # The size of a pixel on the wheel, which softens edges.
        self.pixel = 0.5 * np.float32(np.hypot(*np.gradient(self.u)).mean() + np.hypot(*np.gradient(self.v)).mean())
        base = np.empty((h, w, 3), np.float32)
        base[:] = clip.behind_bgr
        self.blend(base, self.covers(self.u, self.v, 1.0), clip.wheel_bgr)
        if clip.frame is not None:
            for su, sv in ((-1, 1), (1, 1), (1, -1), (-1, -1)):
                at = (su * clip.frame[0], sv * clip.frame[1])
                self.blend(base, self.covers(self.u - at[0], self.v - at[1], 0.07), (235, 235, 235))
        self.base = base
        rows = np.nonzero((np.hypot(self.u, self.v) < 1.05).any(axis=1))[0]
        columns = np.nonzero((np.hypot(self.u, self.v) < 1.05).any(axis=0))[0]
        self.part = (slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1))

    def covers(self, u: Any, v: Any, radius: float) -> Any:
        return np.clip((radius - np.hypot(u, v)) / self.pixel + 0.5, 0.0, 1.0)

    @staticmethod
    def blend(picture: Any, share: Any, bgr: Tuple[int, int, int]) -> None:
        picture += share[:, :, None] * (np.array(bgr, np.float32) - picture)

    def __iter__(self) -> Any:
        clip = self.clip
        random = np.random.default_rng(clip.seed)
        last = None
        u, v = self.u[self.part], self.v[self.part]
        rows = np.arange(clip.size[1], dtype=np.float64)[self.part[0]]
        for i, start in enumerate(clip.frame_times()):
            if i in clip.repeated and last is not None:
                yield last
                continue
            exposures = clip.exposures if clip.shutter > 0.0 else 1
            share_of = [np.zeros(u.shape, np.float32) for _ in clip.marks]
            for j in range(exposures):
                middle = start + (j + 0.5) / exposures * clip.shutter / clip.fps
                if clip.readout_s != 0.0:
                    at = middle + clip.readout_s * rows / clip.size[1]
                    angle = np.array([clip.motion(float(t)) for t in at])[:, None]
                else:
                    angle = np.array([[clip.motion(middle)]])
                for share, mark in zip(share_of, clip.marks):
                    turned = angle + math.radians(mark.angle_deg)
                    du = u - (mark.at * np.cos(turned)).astype(np.float32)
                    dv = v - (mark.at * np.sin(turned)).astype(np.float32)
                    share += self.covers(du, dv, mark.radius) / exposures
            picture = self.base.copy()
            for k, (share, mark) in enumerate(zip(share_of, clip.marks)):
                if not (k == 0 and i in clip.hidden):
                    self.blend(picture[self.part], share, mark.bgr)
            if clip.shake_px > 0.0:
                dx, dy = (int(round(d)) for d in random.normal(0.0, clip.shake_px, 2))
                picture = np.roll(picture, (dy, dx), axis=(0, 1))
            if clip.noise > 0.0:
                picture += random.normal(0.0, clip.noise, picture.shape).astype(np.float32)
            last = np.clip(picture + 0.5, 0, 255).astype(np.uint8)
            yield last


def follow(video: Path, python: str, **settings: Any) -> Any:
    """What the tracker finds; raises its message."""
    tracker = Path(__file__).resolve().parents[2] / "crates/pulsetrain/src/film/tracker.py"
    asked = json.dumps({"video": str(video), **settings})
    ran = subprocess.run([python, "-", asked], input=tracker.read_bytes(), stdout=subprocess.PIPE, check=True)
    last = json.loads(ran.stdout.decode().splitlines()[-1])
    if "error" in last:
        raise LookupError(f"{last['error']}; {last['help']}")
    return last["track"]


def errors_deg(clip: Clip, track: Any) -> Tuple[Any, Any]:
    """Angle found − angle rendered, without the mean, and the standard deviations that the tracker states, degrees."""
    times = np.array([frame[0] for frame in track["frames"]])
    seen = np.array([frame[1] for frame in track["frames"]])
    true = np.degrees([clip.motion(float(t)) for t in times])
    off = seen - true
    off -= off[0]
    off -= 360.0 * np.round(off / 360.0) * (np.abs(off) > 180.0)
    return off - off.mean(), np.array([frame[2] for frame in track["frames"]])
