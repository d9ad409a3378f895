"""Follows two marks on a wheel through a clip: the wheel's angle in each frame, with its uncertainty.

`pulsetrain film` runs this with the user's Python. It needs the packages opencv-python-headless and av (PyAV).

Input: one argument, JSON: {"video": path, ...}; the keys are those of `Settings`. Output: lines of JSON on standard
output: {"progress": share} while it works; at the end {"track": …} or {"error": …, "help": …}.

How it works:
1. `Clip` reads frames with the clip's own time stamps. Some frames that differ most are kept as samples.
2. `find_blobs` finds compact spots in the samples. Spots that move are candidates for marks, spots that stay are
   candidates for the four marks on the frame.
3. `choose_marks` takes the two that keep their distance best.
4. `Follower` finds both in each frame, and measures their centroids with the noise of the picture around them.
5. `Wheel` fits, to all frames at once, the view of a turning wheel: centre, tilt, perspective, where the marks are on
   it, the shutter's read-out time, and the angle of each frame. What does not fit says how uncertain an angle is.

Angles count counter-clockwise, as seen in the picture.
"""

import itertools
import json
import math
import sys
from dataclasses import dataclass, field
from typing import Any, Dict, Iterator, List, Optional, Tuple

import av
import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Picture = NDArray[Any]

# At most this many samples; they are chosen from four times as many.
SAMPLES = 16
# Error of a mark's middle from the grid of pixels and the compression, px. It repeats where the mark does, so a wheel that turns slowly or little does not
# average it. Measured on rendered clips: their errors were up to 2.5 times the σ without it.
GRID_PX = 0.04
# Fewest frames with both marks that can be fitted.
FEWEST_FRAMES = 8
# A spot is at least this large, pixels.
SMALLEST_AREA = 12
# A spot is at most this share of the picture.
LARGEST_SHARE = 0.03
# Levels at which a picture is cut into spots.
LEVELS = 9
# Colours that differ by less are one colour (Lab, Euclidean).
SAME_COLOUR = 28.0


class Refused(Exception):
    """Why the clip cannot be tracked, and what to do."""

    def __init__(self, message: str, advice: str = "") -> None:
        super().__init__(message)
        self.advice = advice


@dataclass
class Settings:
    """What the user said."""

    video: str
    #: Exposure of a frame, s.
    exposure_s: float = 0.0
    #: Time from the first row's exposure to the last row's, s; None: it is fitted.
    readout_s: Optional[float] = None
    #: How many times slower the clip plays than the wheel turned.
    slow: float = 1.0
    #: Part of the clip, s of the clip.
    from_s: Optional[float] = None
    to_s: Optional[float] = None
    #: The marks: [x, y] in the first frame, or [b, g, r].
    marks: List[List[float]] = field(default_factory=list)
    #: Width and height of the rectangle between the frame's marks, in any unit.
    frame: Optional[List[float]] = None
    #: Where the frame's marks are, pixels; empty: they are looked for.
    corners: List[List[float]] = field(default_factory=list)
    #: Where to draw what was found.
    picture: Optional[str] = None


# Clip


class Clip:
    """The frames of a video file, with its own time stamps."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.frames = 0

    def read(self) -> Iterator[Tuple[float, Picture]]:
        """Time stamp, s, and picture (BGR) of each frame."""
        settings = self.settings
        try:
            container = av.open(settings.video)
        except (av.error.FFmpegError, OSError) as error:
            text = getattr(error, "strerror", None) or str(error)
            raise Refused(
                f"cannot read {settings.video}: {text}", "it must be a video file, such as MP4, MOV, AVI or MKV"
            ) from None
        with container:
            if not container.streams.video:
                raise Refused(f"{settings.video} has no pictures", "it must be a video file, such as MP4, MOV, AVI or MKV")
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            last = -math.inf
            count = 0
            frames = container.decode(stream)
            while True:
                try:
                    frame = next(frames)
                except StopIteration:
                    break
                except av.error.FFmpegError:
                    # A clip that was cut off ends here.
                    break
                if frame.pts is None or frame.time_base is None:
                    raise Refused(
                        f"frame {count + 1} of {settings.video} has no time stamp",
                        "a file with time stamps is needed, such as the camera's own MP4 or MOV, not a raw stream",
                    )
                time = float(frame.pts * frame.time_base)
                count += 1
                if time <= last:
                    raise Refused(
                        f"frame {count} of {settings.video} has the time {time:.6f} s, and the frame before {last:.6f} s",
                        "time stamps must grow: take the camera's own file",
                    )
                last = time
                if settings.from_s is not None and time < settings.from_s:
                    continue
                if settings.to_s is not None and time > settings.to_s:
                    break
                yield time, frame.to_ndarray(format="bgr24")
        if count == 0:
            raise Refused(f"{settings.video} has no frame that can be decoded", "play it: is it whole?")

    def samples(self) -> List[Picture]:
        """Frames that differ from one another, the first among them. Counts all frames."""
        kept: List[Picture] = []
        every = 1
        self.frames = 0
        for _, picture in self.read():
            if self.frames % every == 0:
                kept.append(picture)
                if len(kept) == 4 * SAMPLES:
                    kept = kept[::2]
                    every *= 2
            self.frames += 1
        if self.frames < FEWEST_FRAMES:
            raise Refused(
                f"the clip has {self.frames} frames; at least {FEWEST_FRAMES} are needed",
                "film longer, or with more frames in a second",
            )
        small = [cv2.resize(p, (80, 60), interpolation=cv2.INTER_AREA).astype(np.float32) for p in kept]
        chosen = [0]
        distance = np.array([float(np.abs(s - small[0]).mean()) for s in small])
        while len(chosen) < min(SAMPLES, len(kept)):
            following = int(distance.argmax())
            if distance[following] <= 0.0:
                break
            chosen.append(following)
            distance = np.minimum(distance, [float(np.abs(s - small[following]).mean()) for s in small])
        return [kept[k] for k in chosen]


# Spots


@dataclass
class Blob:
    """A compact spot of one colour."""

    x: float
    y: float
    area: float
    colour: Floats  # Lab
    contrast: float  # to what is around it, Lab

    @property
    def radius(self) -> float:
        return math.sqrt(self.area / math.pi)


def lab(picture: Picture) -> NDArray[np.float32]:
    """Lab, 0 to 100 and about ±100."""
    return np.asarray(cv2.cvtColor(picture.astype(np.float32) / 255.0, cv2.COLOR_BGR2Lab), dtype=np.float32)


def find_blobs(picture: Picture) -> List[Blob]:
    """All compact spots of a picture, dark or light or coloured."""
    height, width = picture.shape[:2]
    scale = min(1.0, 640.0 / max(height, width))
    if scale < 1.0:
        picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    image = lab(cv2.GaussianBlur(picture, (0, 0), 1.0))
    found: List[Tuple[float, float, float, float, float]] = []
    largest = LARGEST_SHARE * image.shape[0] * image.shape[1]
    for channel in range(3):
        plane = np.ascontiguousarray(image[:, :, channel])
        low, high = (float(v) for v in np.percentile(plane, [0.05, 99.95]))
        if high - low < 12.0:
            continue
        for level in np.linspace(low, high, LEVELS + 2)[1:-1]:
            above = (plane > level).astype(np.uint8)
            for mask in (above, 1 - above):
                _, labels, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=8)
                wide, tall, areas = stats[:, 2], stats[:, 3], stats[:, 4]
                fits = (areas >= SMALLEST_AREA) & (areas <= largest)
                fits &= np.maximum(wide, tall) <= 6 * np.minimum(wide, tall)
                fits &= (stats[:, 0] > 0) & (stats[:, 1] > 0)
                fits &= (stats[:, 0] + wide < mask.shape[1]) & (stats[:, 1] + tall < mask.shape[0])
                fits[0] = False
                for k in np.nonzero(fits)[0]:
                    x, y, w, h, area = (int(v) for v in stats[k])
                    ys, xs = np.nonzero(labels[y : y + h, x : x + w] == k)
                    covariance = np.cov(np.stack([xs, ys])) + np.eye(2) / 12.0
                    spread = np.linalg.eigvalsh(covariance)
                    # An ellipse's area follows from its second moments; other shapes have less.
                    fill = area / (4.0 * math.pi * math.sqrt(float(spread[0] * spread[1])))
                    if fill < 0.85 or spread[1] > 16.0 * spread[0]:
                        continue
                    found.append((float(centres[k][0]), float(centres[k][1]), float(area), float(level), float(channel)))
    # The same spot is found at several levels: it counts once, with its middle area, if two levels see it.
    blobs: List[Blob] = []
    rest = sorted(found, key=lambda b: -b[2])
    used = [False] * len(rest)
    for i, first in enumerate(rest):
        if used[i]:
            continue
        radius = math.sqrt(first[2] / math.pi)
        group = [
            j
            for j in range(i, len(rest))
            if not used[j]
            and math.hypot(rest[j][0] - first[0], rest[j][1] - first[1]) < max(1.5, 0.35 * radius)
        ]
        for j in group:
            used[j] = True
        if len(group) < 2:
            continue
        middle = rest[group[len(group) // 2]]
        blob = measured(image, middle[0], middle[1], middle[2])
        if blob is not None and blob.contrast > 12.0:
            blobs.append(
                Blob((blob.x + 0.5) / scale - 0.5, (blob.y + 0.5) / scale - 0.5, blob.area / scale**2, blob.colour, blob.contrast)
            )
    return blobs


def measured(image: NDArray[np.float32], x: float, y: float, area: float) -> Optional[Blob]:
    """A spot with its colour and its contrast to a ring around it."""
    radius = math.sqrt(area / math.pi)
    reach = int(math.ceil(2.2 * radius + 3))
    x0, y0 = max(0, int(x) - reach), max(0, int(y) - reach)
    window = image[y0 : int(y) + reach + 1, x0 : int(x) + reach + 1]
    ys, xs = np.mgrid[0 : window.shape[0], 0 : window.shape[1]]
    distance = np.hypot(xs + x0 - x, ys + y0 - y)
    inside, ring = distance < max(1.0, 0.6 * radius), (distance > 1.4 * radius + 1) & (distance < 2.2 * radius + 3)
    if not inside.any() or not ring.any():
        return None
    colour = np.median(window[inside], axis=0).astype(np.float64)
    around = np.median(window[ring], axis=0).astype(np.float64)
    return Blob(x, y, area, colour, float(np.linalg.norm(colour - around)))


@dataclass
class Mark:
    """A mark on the wheel: its colour, and its size in the picture."""

    colour: Floats
    radius: float
    #: Where it was in the samples: (sample, x, y).
    seen: List[Tuple[int, float, float]]
    contrast: float

    def at(self, sample: int) -> List[Tuple[float, float]]:
        return [(x, y) for s, x, y in self.seen if s == sample]


def sort_out(samples: List[List[Blob]]) -> Tuple[List[Mark], List[Blob]]:
    """Spots that move, put together by colour and size; and spots that stay."""
    every = [(s, blob) for s, blobs in enumerate(samples) for blob in blobs]
    still: List[Blob] = []
    moving: List[Tuple[int, Blob]] = []
    for s, blob in every:
        near = 0.25 * blob.radius + 1.5
        same = {
            other
            for other, b in every
            if math.hypot(b.x - blob.x, b.y - blob.y) < near and 0.6 < b.area / blob.area < 1.7
        }
        if len(same) > 0.6 * len(samples) and len(samples) > 2:
            if all(math.hypot(b.x - blob.x, b.y - blob.y) > near for b in still):
                still.append(blob)
        else:
            moving.append((s, blob))
    groups: List[List[Tuple[int, Blob]]] = []
    for s, blob in sorted(moving, key=lambda item: -item[1].contrast):
        for group in groups:
            first = group[0][1]
            if float(np.linalg.norm(first.colour - blob.colour)) < SAME_COLOUR and 0.4 < blob.area / first.area < 2.5:
                group.append((s, blob))
                break
        else:
            groups.append([(s, blob)])
    marks = [
        Mark(
            np.median([b.colour for _, b in group], axis=0),
            float(np.median([b.radius for _, b in group])),
            [(s, b.x, b.y) for s, b in group],
            float(np.median([b.contrast for _, b in group])),
        )
        for group in groups
    ]
    return marks, still


def choose_marks(marks: List[Mark], count: int) -> Tuple[Mark, Mark]:
    """The two that keep their distance while they turn. They may look alike: then both are the same `Mark`."""
    best: Optional[Tuple[float, Mark, Mark]] = None
    for a, b in itertools.combinations_with_replacement(marks, 2):
        pairs = []
        for s in range(count):
            at_a, at_b = a.at(s), b.at(s)
            if a is b:
                if len(at_a) == 2:
                    pairs.append((at_a[0], at_a[1]))
            elif len(at_a) == 1 and len(at_b) == 1:
                pairs.append((at_a[0], at_b[0]))
        if len(pairs) < max(3, 0.35 * count):
            continue
        apart = np.array([math.hypot(p[0] - q[0], p[1] - q[1]) for p, q in pairs])
        middle = float(np.median(apart))
        if middle < 2.5 * (a.radius + b.radius) / 2.0 or float(np.percentile(np.abs(apart - middle), 75)) > 0.3 * middle:
            continue
        score = len(pairs) / count * min(a.contrast, b.contrast) * math.sqrt(min(a.radius, b.radius) * middle)
        if best is None or score > best[0]:
            best = (score, a, b)
    if best is None:
        if not marks:
            raise Refused(
                "no marks that move were found",
                "put two round marks on the wheel, in a colour that the wheel has not; more light, a shorter exposure; "
                "--mark red --mark blue, or --mark X,Y twice, says which they are",
            )
        places = "; ".join(f"one at {m.seen[0][1]:.0f},{m.seen[0][2]:.0f}" for m in marks[:6])
        raise Refused(
            f"no two marks were found that keep their distance; moving spots: {places}",
            "put two round marks on opposite sides of the wheel; --mark red --mark blue, or --mark X,Y twice, says "
            "which they are",
        )
    return best[1], best[2]


def marks_told(settings: Settings, first: Picture, marks: List[Mark]) -> Tuple[Mark, Mark]:
    """The marks that the user named, by colour or by where they are in the first frame."""
    chosen: List[Mark] = []
    for told in settings.marks:
        if len(told) == 2:
            x, y = told
            if not (0 <= x < first.shape[1] and 0 <= y < first.shape[0]):
                raise Refused(
                    f"--mark {x:.0f},{y:.0f} is outside of the picture",
                    f"the picture has {first.shape[1]} × {first.shape[0]} pixels",
                )
            near = [b for b in find_blobs(first) if math.hypot(b.x - x, b.y - y) < max(8.0, 1.5 * b.radius)]
            if not near:
                raise Refused(f"there is no spot at {x:.0f},{y:.0f} in the first frame", "name the middle of a mark")
            blob = min(near, key=lambda b: math.hypot(b.x - x, b.y - y))
            chosen.append(Mark(blob.colour, blob.radius, [(0, blob.x, blob.y)], blob.contrast))
        else:
            colour = lab(np.array([[told]], dtype=np.float32))[0, 0].astype(np.float64)
            near_colour = sorted(marks, key=lambda m: chroma_distance(m.colour, colour))
            if not near_colour or chroma_distance(near_colour[0].colour, colour) > 60.0:
                raise Refused(
                    f"no spot of the colour #{int(told[2]):02x}{int(told[1]):02x}{int(told[0]):02x} moves",
                    "--mark X,Y names a mark by its place in the first frame",
                )
            chosen.append(near_colour[0])
    a, b = chosen
    if float(np.linalg.norm(a.colour - b.colour)) < SAME_COLOUR and 0.5 < a.radius / b.radius < 2.0:
        # They look alike: one description for both.
        both = a if a is b else Mark((a.colour + b.colour) / 2, (a.radius + b.radius) / 2, a.seen + b.seen, a.contrast)
        return both, both
    return a, b


def chroma_distance(a: Floats, b: Floats) -> float:
    """How different two colours are to the eye, light and shade counting less than the hue."""
    return float(np.linalg.norm((a - b) * np.array([0.5, 1.0, 1.0])))


# Following


@dataclass
class Seen:
    """A mark in a frame: its centroid, and the variance that the picture's noise gives it, pixels²."""

    x: float
    y: float
    variance: float
    area: float
    #: How long it is compared with its width.
    stretch: float


class Follower:
    """Finds the two marks in each frame."""

    def __init__(self, marks: Tuple[Mark, Mark], samples: List[Picture]) -> None:
        self.marks = marks
        self.alike = marks[0] is marks[1]
        places = np.array([(x, y) for mark in marks for _, x, y in mark.seen])
        radius = max(mark.radius for mark in marks)
        height, width = samples[0].shape[:2]
        if len(places) >= 6:
            # The circle on which the marks run, seen as an ellipse: its box with a margin.
            low, high = places.min(axis=0), places.max(axis=0)
            reach = float(np.hypot(*(high - low))) / 2.0 + 3.0 * radius
            middle = places.mean(axis=0)
            corners = np.concatenate([middle - reach, middle + reach])
        else:
            corners = np.array([0.0, 0.0, float(width), float(height)])
        x0, y0 = max(0, int(corners[0])), max(0, int(corners[1]))
        self.area = (x0, y0, min(width, int(corners[2]) + 1), min(height, int(corners[3]) + 1))
        largest = max(self.area[2] - x0, self.area[3] - y0)
        #: Marks are looked for in a smaller picture, so long as they stay 6 pixels wide.
        self.coarse = max(1, min(int(largest / 160), int(min(mark.radius for mark in marks) / 3)))
        self.colours = [mark.colour for mark in marks]
        self.before: List[Tuple[float, float, float]] = []

    def candidates(self, image: NDArray[np.float32], k: int) -> List[Tuple[float, float, float, float]]:
        """Spots of a mark's colour: x, y, area, likeness."""
        mark = self.marks[k]
        colour = mark.colour.astype(np.float32)
        distance = np.linalg.norm(image - colour, axis=2)
        # A mark that moves mixes with what is behind it.
        found: List[Tuple[float, float, float, float]] = []
        expected = math.pi * (mark.radius / self.coarse) ** 2
        for share in (0.4, 0.65):
            mask = (distance < share * mark.contrast).astype(np.uint8)
            number, _, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=8)
            for n in range(1, number):
                area = float(stats[n][4])
                if not 0.2 * expected <= area <= 6.0 * expected:
                    continue
                long_side, short_side = max(stats[n][2:4]), min(stats[n][2:4])
                if area < 0.35 * long_side * short_side and long_side < 3 * short_side:
                    continue
                likeness = abs(math.log(area / expected))
                at = (float(centres[n][0]), float(centres[n][1]))
                if all(math.hypot(at[0] - f[0], at[1] - f[1]) > mark.radius / self.coarse for f in found):
                    found.append((at[0], at[1], area, likeness))
        # In pixels of the frame.
        c = self.coarse
        return [
            ((x + 0.5) * c - 0.5 + self.area[0], (y + 0.5) * c - 0.5 + self.area[1], area * c * c, likeness)
            for x, y, area, likeness in sorted(found, key=lambda f: f[3])[:12]
        ]

    def centroid(self, picture: Picture, x: float, y: float, k: int, area: float) -> Optional[Seen]:
        """Centroid of a mark near a place, finer than a pixel."""
        mark = self.marks[k]
        reach = int(math.ceil(max(1.35 * mark.radius, 0.9 * math.sqrt(area)) + 5))
        height, width = picture.shape[:2]
        for attempt in range(3):
            x0, y0 = max(0, int(x) - reach), max(0, int(y) - reach)
            x1, y1 = min(width, int(x) + reach + 2), min(height, int(y) + reach + 2)
            if x1 - x0 < reach or y1 - y0 < reach:
                return None
            window = picture[y0:y1, x0:x1].astype(np.float64)
            ys, xs = np.mgrid[y0:y1, x0:x1].astype(np.float64)
            edge = np.ones(window.shape[:2], dtype=bool)
            edge[2:-2, 2:-2] = False
            around = np.median(window[edge], axis=0)
            core = np.hypot(xs - x, ys - y) < max(1.5, 0.5 * mark.radius)
            towards = np.median(window[core], axis=0) - around
            size = float(towards @ towards)
            if size < 100.0:
                return None
            share = (window - around) @ towards / size
            # The mark and its soft edge, without other spots in the window.
            number, labels, stats, _ = cv2.connectedComponentsWithStats((share > 0.35).astype(np.uint8), connectivity=8)
            if number < 2:
                return None
            inner = labels[core & (labels > 0)]
            if not len(inner):
                return None
            own = int(np.bincount(inner).argmax())
            left, top, wide, tall = (int(v) for v in stats[own][:4])
            if x0 + left <= 0 or y0 + top <= 0 or x0 + left + wide >= width or y0 + top + tall >= height:
                # The picture's edge cuts it.
                return None
            if attempt == 0 and (
                left <= 2 or top <= 2 or left + wide >= window.shape[1] - 2 or top + tall >= window.shape[0] - 2
            ):
                # It is smeared beyond the window.
                reach = int(reach * 1.7)
                continue
            soft = max(2, int(round(0.2 * mark.radius)))
            support = cv2.dilate((labels == own).astype(np.uint8), np.ones((2 * soft + 1, 2 * soft + 1), np.uint8)) > 0
            others = cv2.dilate(((labels > 0) & (labels != own)).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
            support &= ~others
            outside = ~support & ~others
            if int(outside.sum()) < 12:
                return None
            level = float(np.median(share[outside]))
            noise = 1.4826 * float(np.median(np.abs(share[outside] - level)))
            weight = np.where(support, share - level, 0.0)
            total = float(weight.sum())
            if total <= 0.0:
                return None
            cx, cy = float((weight * xs).sum()) / total, float((weight * ys).sum()) / total
            if attempt < 2 and math.hypot(cx - x, cy - y) > 0.5:
                x, y = cx, cy
                continue
            dx, dy = xs - cx, ys - cy
            # Rounding to 8 bits is noise, too; and no shape is known to a hundredth of a pixel.
            noise = math.hypot(noise, 0.3 / math.sqrt(size))
            variance = noise**2 * float(((dx**2 + dy**2) / 2.0)[support].sum()) / total**2 + 1e-4
            moments = np.array([[(weight * dx * dx).sum(), (weight * dx * dy).sum()], [0.0, (weight * dy * dy).sum()]])
            moments[1, 0] = moments[0, 1]
            spread = np.linalg.eigvalsh(moments / total)
            stretch = math.sqrt(max(1.0, float(spread[1] / max(spread[0], 1e-6))))
            return Seen(cx, cy, variance, float((labels == own).sum()), stretch)
        return None

    def look(self, picture: Picture, wheel: Optional["Wheel"]) -> Tuple[Optional[Seen], Optional[Seen]]:
        """Both marks in a frame. `wheel`: their places relative to one another, if they are known."""
        x0, y0, x1, y1 = self.area
        part = picture[y0:y1, x0:x1]
        if self.coarse > 1:
            small = (part.shape[1] // self.coarse, part.shape[0] // self.coarse)
            part = cv2.resize(
                part[: small[1] * self.coarse, : small[0] * self.coarse], small, interpolation=cv2.INTER_AREA
            )
        image = lab(cv2.GaussianBlur(part, (3, 3), 0))
        found = [self.candidates(image, k) for k in ((0,) if self.alike else (0, 1))]
        if self.alike:
            found.append(found[0])
        best: Optional[Tuple[float, Any, Any]] = None
        for a, b in itertools.product(*found):
            if a is b:
                continue
            cost = a[3] + b[3]
            if wheel is not None:
                angle, off = wheel.place((a[0], a[1]), (b[0], b[1]))
                cost += off / (0.15 * wheel.size)
                if off > 0.3 * wheel.size:
                    continue
                if self.alike:
                    expected = self.expected()
                    if expected is not None:
                        cost += 2.0 * abs(wrap(angle - expected)) / math.pi
            elif math.hypot(a[0] - b[0], a[1] - b[1]) < 2.0 * max(m.radius for m in self.marks):
                continue
            if best is None or cost < best[0]:
                best = (cost, a, b)
        if best is not None:
            one = self.centroid(picture, best[1][0], best[1][1], 0, best[1][2])
            two = self.centroid(picture, best[2][0], best[2][1], 1, best[2][2])
            if wheel is not None and one is not None and two is not None:
                angle, _ = wheel.place((one.x, one.y), (two.x, two.y))
                self.before = (self.before + [(angle, 0.0, 0.0)])[-2:]
            return one, two
        # One alone, where the other is hidden.
        if wheel is not None and not self.alike:
            for k in (0, 1):
                alone = [c for c in found[k] if wheel.is_on_track((c[0], c[1]), k) and c[3] < 0.5]
                if len(alone) == 1:
                    seen = self.centroid(picture, alone[0][0], alone[0][1], k, alone[0][2])
                    return (seen, None) if k == 0 else (None, seen)
        return None, None

    def expected(self) -> Optional[float]:
        """The angle that a steady turn leads to."""
        if not self.before:
            return None
        if len(self.before) == 1:
            return self.before[0][0]
        return self.before[1][0] + wrap(self.before[1][0] - self.before[0][0])


def wrap(angle: float) -> float:
    """Into -π to π."""
    return math.remainder(angle, 2.0 * math.pi)


# The wheel


class Wheel:
    """The view of a turning wheel: p = (c + S·m(θ)) / (1 + g·m(θ)) for each mark's place m on the wheel.

    S is symmetric, so that θ counts from the picture's x axis, and m has y upwards. The first mark's radius is 1. `p` holds
    [cx, cy, sxx, sxy, syy, gx, gy, radius of the second mark, its angle ahead of the first, read-out time].
    """

    def __init__(self, one: Floats, two: Floats) -> None:
        """From places of both marks in some frames, as a circle seen squarely."""
        across = two - one
        turned = np.arctan2(-across[:, 1], across[:, 0])
        cos, sin, zero, unit = np.cos(turned), np.sin(turned), np.zeros(len(one)), np.ones(len(one))
        rows = []
        values = []
        # one = c + (a + ib)·e^{iψ}, two the same with another (a, b); y upwards. A weak wish: c is between the marks.
        for at, first in ((one, True), (two, False)):
            real = [cos, -sin] if first else [zero, zero]
            real += [zero, zero] if first else [cos, -sin]
            imag = [sin, cos] if first else [zero, zero]
            imag += [zero, zero] if first else [sin, cos]
            rows += [np.stack([unit, zero, *real], axis=1), np.stack([zero, unit, *imag], axis=1)]
            values += [at[:, 0], -at[:, 1]]
        middle = (one + two).mean(axis=0) / 2.0
        weak = np.zeros((2, 6))
        weak[0, 0] = weak[1, 1] = 1e-2 * math.sqrt(len(one))
        rows.append(weak)
        values.append(weak[[0, 1], [0, 1]] * np.array([middle[0], -middle[1]]))
        cx, cy, a1, b1, a2, b2 = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0]
        first_radius, second_radius = math.hypot(a1, b1), math.hypot(a2, b2)
        ahead = math.atan2(b2, a2) - math.atan2(b1, a1)
        self.size = max(1e-3, first_radius)
        self.p = np.array(
            [cx, -cy, self.size, 0.0, self.size, 0.0, 0.0, max(1e-3, second_radius / self.size), ahead, 0.0]
        )
        self.covariance = np.zeros((10, 10))
        self.scale = 1.0

    def seen(self, p: Floats, k: int, theta: Floats) -> Floats:
        """Where a mark is seen at some angles."""
        radius, ahead = (1.0, 0.0) if k == 0 else (p[7], p[8])
        u, v = radius * np.cos(theta + ahead), radius * np.sin(theta + ahead)
        below = 1.0 + p[5] * u + p[6] * v
        return np.stack([(p[0] + p[2] * u + p[3] * v) / below, (p[1] - p[3] * u - p[4] * v) / below], axis=1)

    def place(self, one: Tuple[float, float], two: Tuple[float, float]) -> Tuple[float, float]:
        """Angle at which both marks fit best, and how far the worse one is off, pixels."""
        guess = math.atan2(-(two[1] - one[1]), two[0] - one[0])
        start = self.seen(self.p, 1, np.zeros(1))[0] - self.seen(self.p, 0, np.zeros(1))[0]
        theta = guess - math.atan2(-start[1], start[0])
        at = np.array([[one], [two]])
        for _ in range(3):
            off, slope = [], []
            for k in (0, 1):
                here = self.seen(self.p, k, np.array([theta]))
                there = self.seen(self.p, k, np.array([theta + 1e-4]))
                off.append((at[k] - here)[0])
                slope.append(((there - here) / 1e-4)[0])
            turn = sum(float(s @ o) for s, o in zip(slope, off)) / max(1e-9, sum(float(s @ s) for s in slope))
            theta += max(-0.5, min(0.5, turn))
        worst = max(float(np.linalg.norm(at[k][0] - self.seen(self.p, k, np.array([theta]))[0])) for k in (0, 1))
        return theta, worst

    def is_on_track(self, at: Tuple[float, float], k: int) -> bool:
        """Whether a place is on the ellipse that a mark runs along."""
        track = self.seen(self.p, k, np.linspace(0.0, 2.0 * math.pi, 180))
        return float(np.hypot(track[:, 0] - at[0], track[:, 1] - at[1]).min()) < 0.12 * self.size

    def fit(self, observed: "Observed", settings: Settings, squarely: bool) -> Tuple[Floats, Floats]:
        """Fits everything. Gives θ (continuous) and its standard deviation for each frame."""
        theta = np.array([self.angle_of(observed, i) for i in range(len(observed.times))])
        # σ of what is expected of a view before anything is seen: a camera stands roughly before the wheel. A frame with marks
        # corrects the view beforehand.
        tilt, perspective = (0.003, 0.003) if squarely else (0.08, 0.06)
        free = np.ones(10, dtype=bool)
        if settings.readout_s is not None:
            free[9] = False
            self.p[9] = settings.readout_s
        speed = np.zeros(len(theta))
        robust = np.ones((len(theta), 2))
        damping = 1e-3
        # Differences of neighbouring frames are alike while the wheel turns slowly: so many frames say as much as one.
        alike = 1.0

        def rows(p: Floats, angles: Floats) -> Floats:
            """Whitened differences of all frames: n × 4."""
            parts = []
            for k in (0, 1):
                lag = p[9] * (observed.at[k][:, 1] - p[1]) / observed.height
                off = observed.at[k] - self.seen(p, k, angles + speed * lag)
                weight = np.sqrt(robust[:, k] / observed.variance[k] / alike) / self.scale
                parts.append(np.where(observed.found[k][:, None], off * weight[:, None], 0.0))
            return np.concatenate(parts, axis=1)

        def prior(p: Floats) -> Floats:
            middle = 0.5 * (p[2] + p[4])
            longest = 1.2 * observed.interval
            return np.array(
                [
                    (p[2] - p[4]) / middle / tilt,
                    2.0 * p[3] / middle / tilt,
                    p[5] / perspective,
                    p[6] / perspective,
                    p[9] / longest if free[9] else 0.0,
                ]
            )

        steps = np.array([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6, 1e-6, 1e-7])
        for round_ in range(60):
            speed = turning(observed.times, theta) if round_ > 2 else speed
            now = rows(self.p, theta)
            cost = float((now**2).sum() + (prior(self.p) ** 2).sum())
            by_theta = (rows(self.p, theta + 1e-6) - now) / 1e-6
            length = np.maximum((by_theta**2).sum(axis=1), 1e-12)
            columns, prior_columns = [], []
            for j in range(10):
                if not free[j]:
                    continue
                moved = self.p.copy()
                moved[j] += steps[j]
                columns.append((rows(moved, theta) - now) / steps[j])
                prior_columns.append((prior(moved) - prior(self.p)) / steps[j])
            # What the angle of a frame can take up says nothing about the wheel.
            jacobian = np.stack(columns, axis=2)
            along = np.einsum("ni,nij->nj", by_theta, jacobian) / length[:, None]
            reduced = jacobian - by_theta[:, :, None] * along[:, None, :]
            flat = np.concatenate([reduced.reshape(-1, reduced.shape[2]), np.stack(prior_columns, axis=1)])
            own = (by_theta * now).sum(axis=1) / length
            rest = np.concatenate([(now - by_theta * own[:, None]).reshape(-1), prior(self.p)])
            normal = flat.T @ flat
            gradient = flat.T @ rest
            better = False
            for _ in range(8):
                change = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + 1e-12 * np.eye(len(normal)), gradient)
                moved = self.p.copy()
                moved[free] += change
                turned = theta - own - along @ change
                next_rows = rows(moved, turned)
                if float((next_rows**2).sum() + (prior(moved) ** 2).sum()) < cost * (1.0 + 1e-12):
                    better = True
                    break
                damping *= 10.0
            if not better:
                if round_ > 6:
                    break
                # Only the angles.
                theta = theta - own
                damping = 1e-3
                continue
            largest = float(np.abs(turned - theta).max())
            self.p, theta = moved, turned
            damping = max(1e-9, damping / 10.0)
            # Outliers count less; the scale says how much larger the differences are than the picture's noise alone.
            after = rows(self.p, theta).reshape(len(theta), 2, 2) * self.scale * math.sqrt(alike) / np.sqrt(robust)[:, :, None]
            size = np.sqrt((after**2).sum(axis=2) / 2.0)
            inside = size[np.stack(observed.found, axis=1)]
            if len(inside):
                # Of four numbers in a frame three say something: the fourth is the angle. The median of χ with 1.5 of 2.
                self.scale = max(0.3, float(np.median(inside)) / 0.72)
            robust = np.minimum(1.0, 4.0 * self.scale / np.maximum(size, 1e-9)) ** 2
            if round_ > 3:
                alike = likeness(after.reshape(len(theta), 4), robust)
            if round_ > 8 and largest < 1e-7:
                break
        now = rows(self.p, theta)
        by_theta = (rows(self.p, theta + 1e-6) - now) / 1e-6
        length = np.maximum((by_theta**2).sum(axis=1), 1e-12)
        self.robust = robust
        full = np.zeros((10, 10))
        inverse = np.linalg.pinv(flat.T @ flat)
        full[np.ix_(free, free)] = inverse
        self.covariance = full
        # The wheel's own uncertainty moves angles; the part that is the same for all is only a zero.
        common = along - along.mean(axis=0)
        systematic = np.einsum("ni,ij,nj->n", common, inverse, common)
        slope: Floats = np.zeros(len(theta))
        for k in (0, 1):
            per_rad = (self.seen(self.p, k, theta + 1e-4) - self.seen(self.p, k, theta)) / 1e-4
            slope = slope + np.where(observed.found[k], (per_rad**2).sum(axis=1), 0.0)
        grid = GRID_PX**2 / np.maximum(slope, 1e-9)
        return theta, np.sqrt(1.0 / (length * alike) + systematic + grid)

    def angle_of(self, observed: "Observed", i: int) -> float:
        """A first angle of a frame."""
        if observed.found[0][i] and observed.found[1][i]:
            one, two = observed.at[0][i], observed.at[1][i]
            return self.place((float(one[0]), float(one[1])), (float(two[0]), float(two[1])))[0]
        k = 0 if observed.found[0][i] else 1
        angles = np.linspace(0.0, 2.0 * math.pi, 720)
        track = self.seen(self.p, k, angles)
        return float(angles[np.hypot(*(track - observed.at[k][i]).T).argmin()])


@dataclass
class Observed:
    """Both marks in all frames."""

    times: Floats
    at: List[Floats]
    variance: List[Floats]
    found: List[NDArray[np.bool_]]
    height: float
    interval: float


def likeness(differences: Floats, robust: Floats) -> float:
    """How many neighbouring frames have about the same differences: (1 + ρ) / (1 - ρ) of their correlation ρ."""
    inside = np.clip(differences * robust.min(axis=1)[:, None], -10.0, 10.0)
    square = float((inside**2).sum())
    if square <= 0.0 or len(inside) < 4:
        return 1.0
    correlation = float((inside[1:] * inside[:-1]).sum()) / square
    correlation = min(1.0 - 4.0 / len(inside), max(0.0, correlation))
    return (1.0 + correlation) / (1.0 - correlation)


def turning(times: Floats, theta: Floats) -> Floats:
    """Speed at each frame, rad/s."""
    return np.asarray(np.gradient(np.unwrap(theta), times)) if len(times) > 2 else np.zeros(len(times))


# The frame


def frame_corners(settings: Settings, still: List[Blob], centre: Floats) -> List[Tuple[float, float]]:
    """The four marks on the frame: top left, top right, bottom right, bottom left."""
    if settings.corners:
        chosen: List[Blob] = []
        for x, y in settings.corners:
            near = [b for b in still if math.hypot(b.x - x, b.y - y) < max(10.0, 1.5 * b.radius)]
            if not near:
                raise Refused(f"there is no mark of the frame at {x:.0f},{y:.0f}", "name the middle of a mark that stays")
            chosen.append(min(near, key=lambda b: math.hypot(b.x - x, b.y - y)))
        return in_order([(b.x, b.y) for b in chosen])
    best: Optional[Tuple[float, List[Tuple[float, float]]]] = None
    strongest = sorted(still, key=lambda b: -b.contrast * b.radius)[:24]
    for four in itertools.combinations(strongest, 4):
        areas = [b.area for b in four]
        colours = [b.colour for b in four]
        spread = max(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(colours, 2))
        if max(areas) > 2.2 * min(areas) or spread > SAME_COLOUR:
            continue
        corners = in_order([(b.x, b.y) for b in four])
        shape = np.array(corners, dtype=np.float32)
        if not cv2.isContourConvex(shape.reshape(-1, 1, 2)):
            continue
        if cv2.pointPolygonTest(shape.reshape(-1, 1, 2), (float(centre[0]), float(centre[1])), False) <= 0:
            continue
        score = spread / SAME_COLOUR + math.log(max(areas) / min(areas)) - 0.3 * math.log(max(1.0, cv2.contourArea(shape)))
        if best is None or score < best[0]:
            best = (score, corners)
    if best is None:
        raise Refused(
            "the four marks on the frame were not found",
            "they are alike, stay where they are, and the wheel is between them; --corner X,Y four times says where they are; "
            "without --frame the view is worked out from the wheel's own marks",
        )
    return best[1]


def in_order(corners: List[Tuple[float, float]]) -> List[Tuple[float, float]]:
    """Clockwise in the picture, from the top left."""
    middle = np.mean(np.array(corners), axis=0)
    around = sorted(corners, key=lambda c: math.atan2(c[1] - middle[1], c[0] - middle[0]))
    first = min(range(4), key=lambda k: around[k][0] + around[k][1])
    return around[first:] + around[:first]


class Plane:
    """Maps pixels to the frame's plane, in which a circle is a circle; as large as the picture was."""

    def __init__(self, corners: List[Tuple[float, float]], size: List[float]) -> None:
        image = np.array(corners, dtype=np.float64)
        sides = [float(np.hypot(*(image[k] - image[k - 1]))) for k in range(4)]
        scale = sum(sides) / (2.0 * (size[0] + size[1]))
        w, h = 0.5 * size[0] * scale, 0.5 * size[1] * scale
        middle = image.mean(axis=0)
        self.target = np.array([[-w, -h], [w, -h], [w, h], [-w, h]]) + middle
        self.matrix = self.to(image)

    def to(self, image: Floats) -> Floats:
        return np.asarray(
            cv2.getPerspectiveTransform(image.astype(np.float32), self.target.astype(np.float32)), dtype=np.float64
        )

    @staticmethod
    def apply(matrix: NDArray[Any], points: NDArray[Any]) -> Floats:
        below = points @ matrix[2, :2] + matrix[2, 2]
        return np.asarray((points @ matrix[:2, :2].T + matrix[:2, 2]) / below[:, None])


# All together


def track(settings: Settings) -> Dict[str, Any]:
    """The track of a clip."""
    clip = Clip(settings)
    samples = clip.samples()
    report(0.1)
    first = samples[0]
    blobs = [find_blobs(picture) for picture in samples]
    groups, still = sort_out(blobs)
    report(0.2)
    if settings.marks:
        marks = marks_told(settings, first, groups)
    else:
        marks = choose_marks(groups, len(samples))
    follower = Follower(marks, samples)

    # A first wheel from the samples.
    rough = []
    for picture in samples:
        one, two = follower.look(picture, None)
        if one is not None and two is not None:
            rough.append((one.x, one.y, two.x, two.y))
    if len(rough) < 3:
        raise Refused(
            f"both marks were found in {len(rough)} of {len(samples)} sample frames only",
            "more light, a shorter exposure, larger marks; --mark red --mark blue, or --mark X,Y twice, says which they are",
        )
    wheel = first_wheel(np.array(rough), follower.alike)
    corners: List[Tuple[float, float]] = []
    if settings.frame is not None:
        corners = frame_corners(settings, still, wheel.p[:2])

    corner_follower = None
    if corners:
        near = [min(still, key=lambda b: math.hypot(b.x - x, b.y - y)) for x, y in corners]
        stay = Mark(near[0].colour, float(np.mean([b.radius for b in near])), [], near[0].contrast)
        corner_follower = Follower((stay, stay), samples)

    times: List[float] = []
    seen: List[Tuple[Optional[Seen], Optional[Seen]]] = []
    corner_places: List[List[Optional[Tuple[float, float]]]] = []
    twins: List[float] = []
    last_part: Optional[Picture] = None
    x0, y0, x1, y1 = follower.area
    for time, picture in clip.read():
        times.append(time)
        seen.append(follower.look(picture, wheel))
        if corner_follower is not None:
            places: List[Optional[Tuple[float, float]]] = []
            for x, y in corners:
                spot = corner_follower.centroid(picture, x, y, 0, math.pi * corner_follower.marks[0].radius ** 2)
                places.append(None if spot is None else (spot.x, spot.y))
            corner_places.append(places)
        part = picture[y0:y1, x0:x1]
        if last_part is not None:
            twins.append(float(cv2.absdiff(part, last_part).mean()))
        last_part = part
        if len(times) % 16 == 0:
            report(0.2 + 0.7 * len(times) / max(1, clip.frames))
    return assemble(settings, Scene(first, follower, wheel, corners, clip.frames), times, seen, corner_places, twins)


@dataclass
class Scene:
    """What is the same in all frames."""

    first: Picture
    follower: Follower
    wheel: Wheel
    corners: List[Tuple[float, float]]
    frames: int


def first_wheel(rough: Floats, alike: bool) -> Wheel:
    """A wheel from a few frames. Marks that look alike may be in either order: each frame follows the one that is nearest."""
    one, two = rough[:, :2].copy(), rough[:, 2:].copy()
    if alike:
        # Angles twice as large do not know which is which. For marks at different distances from the centre, the
        # order is found by which of the two fits one wheel better.
        best: Optional[Tuple[float, Wheel]] = None
        for flips in itertools.product((False, True), repeat=min(len(rough) - 1, 9)):
            turned = np.array([False, *flips])
            used = len(turned)
            a = np.where(turned[:, None], two[:used], one[:used])
            b = np.where(turned[:, None], one[:used], two[:used])
            wheel = Wheel(a, b)
            off = sum(wheel.place(tuple(p), tuple(q))[1] for p, q in zip(a, b))
            if best is None or off < best[0]:
                best = (off, wheel)
        assert best is not None
        return best[1]
    wheel = Wheel(one, two)
    for _ in range(2):
        away = np.array([wheel.place(tuple(p), tuple(q))[1] for p, q in zip(one, two)])
        near = away <= max(3.0 * float(np.median(away)), 2.0)
        if near.sum() >= 3:
            wheel = Wheel(one[near], two[near])
    return wheel


def assemble(
    settings: Settings,
    scene: Scene,
    times: List[float],
    seen: List[Tuple[Optional[Seen], Optional[Seen]]],
    corner_places: List[List[Optional[Tuple[float, float]]]],
    twins: List[float],
) -> Dict[str, Any]:
    """Fits the wheel to what was seen."""
    wheel = scene.wheel
    some = [i for i, (one, two) in enumerate(seen) if one is not None or two is not None]
    both = [i for i in some if seen[i][0] is not None and seen[i][1] is not None]
    if len(both) < max(FEWEST_FRAMES, len(times) // 3):
        lost = next((times[i] for i in range(len(times)) if i not in set(both)), 0.0)
        raise Refused(
            f"both marks were found in {len(both)} of {len(times)} frames only; first lost at {lost:.3f} s of the clip",
            "more light, a shorter exposure, larger marks that nothing hides; --mark says which spots they are; "
            "--from and --to take a part of the clip",
        )
    height = float(scene.first.shape[0])
    at = [np.zeros((len(some), 2)) for _ in (0, 1)]
    variance = [np.ones(len(some)) for _ in (0, 1)]
    found = [np.zeros(len(some), dtype=bool) for _ in (0, 1)]
    stretch = np.ones(len(some))
    for n, i in enumerate(some):
        for k in (0, 1):
            mark = seen[i][k]
            if mark is not None:
                at[k][n] = (mark.x, mark.y)
                variance[k][n] = mark.variance
                found[k][n] = True
                stretch[n] = max(stretch[n], mark.stretch)
    raw = [a.copy() for a in at]
    squarely = False
    shake = 0.0
    if scene.corners and settings.frame is not None:
        squarely = True
        plane = Plane(scene.corners, settings.frame)
        known = np.array([[[math.nan, math.nan] if c is None else c for c in corner_places[i]] for i in some])
        mean = np.nanmedian(known, axis=0)
        mean = np.where(np.isnan(mean), np.array(scene.corners), mean)
        plane.matrix = plane.to(mean)
        # A tripod's frame is the same in all frames, and its mean has less noise; one held by hand moves.
        moves = known - mean
        shake = float(np.sqrt(np.nanmean(np.nanmean(moves, axis=1) ** 2))) if np.isfinite(moves).any() else 0.0
        for n in range(len(some)):
            whole = not np.isnan(known[n]).any()
            matrix = plane.to(known[n]) if shake > 0.25 and whole else plane.matrix
            for k in (0, 1):
                at[k][n] = Plane.apply(matrix, at[k][n][None, :])[0]
        keep = found[0] & found[1]
        wheel = Wheel(at[0][keep], at[1][keep])
    clip_times = np.array([times[i] for i in some])
    real = clip_times / settings.slow
    interval = float(np.median(np.diff(np.array(times) / settings.slow)))
    observed = Observed(real, at, variance, found, height, interval)
    theta, sigma = wheel.fit(observed, settings, squarely)
    report(0.98)
    theta = np.unwrap(theta)
    # Frames that a converter or the camera repeated show a wheel of another time.
    repeated = np.zeros(len(some), dtype=bool)
    for n in range(1, len(some) - 1):
        i = some[n]
        if not 1 < i < len(twins):
            continue
        before, after = theta[n] - theta[n - 1], theta[n + 1] - theta[n]
        stays = abs(before) < 0.2 * abs(after) and abs(after) > 8.0 * sigma[n]
        repeated[n] = stays and twins[i - 1] < 0.4 * min(twins[i - 2], twins[i])
    # A frame that does not fit the wheel at all is no measurement.
    wrong = (wheel.robust.min(axis=1) < 0.01) & (found[0] & found[1])
    good = ~repeated & ~wrong
    if int(good.sum()) < FEWEST_FRAMES:
        raise Refused(
            "the two spots do not move like marks on one wheel",
            "--mark red --mark blue, or --mark X,Y twice, says which spots are the marks",
        )
    readout = float(wheel.p[9])
    readout_sigma = math.sqrt(max(0.0, float(wheel.covariance[9, 9]))) if settings.readout_s is None else 0.0
    centre = wheel.p[:2]
    if squarely:
        inverse = np.linalg.inv(plane.matrix)
        centre = Plane.apply(inverse, centre[None, :])[0]
    when = real + settings.exposure_s / 2.0 + readout * float(centre[1]) / height
    shape = np.array([[wheel.p[2], wheel.p[3]], [wheel.p[3], wheel.p[4]]])
    axes = np.linalg.svd(shape, compute_uv=False)
    if settings.picture is not None:
        draw(settings.picture, scene, wheel, plane.matrix if squarely else None, raw, found)
    degrees = 180.0 / math.pi
    names = [colour_name(mark.colour) for mark in scene.follower.marks]
    gaps = np.diff(np.array(times) / settings.slow)
    return {
        "frames": [
            [round(float(t), 9), round(float(a) * degrees, 6), round(float(s) * degrees, 6)]
            for t, a, s in zip(when[good], theta[good], sigma[good])
        ],
        "in_clip": len(times),
        "lost": len(times) - len(some),
        "one_mark": int((~(found[0] & found[1])).sum()),
        "repeated": int(repeated.sum()),
        "not_fitting": int((wrong & ~repeated).sum()),
        "interval_s": interval,
        "longest_gap_s": float(gaps.max()) if len(gaps) else 0.0,
        "width": int(scene.first.shape[1]),
        "height": int(height),
        "centre": [float(centre[0]), float(centre[1])],
        "marks": [
            {"colour": names[k], "x": float(raw[k][found[k]][0][0]), "y": float(raw[k][found[k]][0][1])} for k in (0, 1)
        ],
        "alike": scene.follower.alike,
        "apart_px": float(np.median(np.hypot(*(raw[0] - raw[1])[found[0] & found[1]].T))),
        "tilt_deg": math.degrees(math.acos(min(1.0, float(axes[1] / axes[0])))),
        "frame_used": squarely,
        "shake_px": shake,
        "readout_s": readout,
        "readout_sigma_s": readout_sigma,
        "readout_given": settings.readout_s is not None,
        "stretch": float(np.percentile(stretch, 95)),
    }


def colour_name(colour: Floats) -> str:
    """A word for a colour in Lab."""
    light, a, b = (float(v) for v in colour)
    if math.hypot(a, b) < 18.0:
        return "black" if light < 35 else "grey" if light < 75 else "white"
    hue = math.degrees(math.atan2(b, a)) % 360.0
    names = [(20, "pink" if light > 60 else "red"), (55, "red"), (75, "orange"), (110, "yellow"), (170, "green"),
             (230, "cyan"), (310, "blue"), (345, "purple"), (361, "pink")]
    return next(name for limit, name in names if hue < limit)


def draw(
    path: str, scene: Scene, wheel: Wheel, plane: Optional[Floats], raw: List[Floats], found: List[NDArray[np.bool_]]
) -> None:
    """What was found, over the first frame."""
    picture = scene.first.copy()
    inverse = None if plane is None else np.linalg.inv(plane)

    def pixels(points: Floats) -> Any:
        points = points if inverse is None else Plane.apply(inverse, points)
        return np.round(points * 16).astype(np.int32).reshape(-1, 1, 2)

    circle = np.linspace(0.0, 2.0 * math.pi, 181)
    colours = [(0, 255, 255), (255, 255, 0)]
    for k in (0, 1):
        cv2.polylines(picture, [pixels(wheel.seen(wheel.p, k, circle))], True, colours[k], 1, cv2.LINE_AA, 4)
        x, y = raw[k][found[k]][0]
        radius = int(16 * (scene.follower.marks[k].radius + 3))
        cv2.circle(picture, (int(16 * x), int(16 * y)), radius, colours[k], 2, cv2.LINE_AA, 4)
        cv2.putText(picture, str(k + 1), (int(x) + radius // 16 + 2, int(y)), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colours[k], 1)
    centre = pixels(wheel.p[None, :2])[0, 0] // 16
    cv2.drawMarker(picture, (int(centre[0]), int(centre[1])), (0, 0, 255), cv2.MARKER_CROSS, 16, 1)
    if scene.corners:
        cv2.polylines(
            picture, [np.round(np.array(scene.corners) * 16).astype(np.int32).reshape(-1, 1, 2)], True, (0, 255, 0), 1,
            cv2.LINE_AA, 4,
        )
    ok, data = cv2.imencode(".png", picture)
    if ok:
        with open(path, "wb") as file:
            file.write(data.tobytes())


def say(**values: Any) -> None:
    print(json.dumps(values), flush=True)


def report(share: float) -> None:
    say(progress=round(share, 3))


def main() -> None:
    av.logging.set_level(av.logging.PANIC)
    try:
        say(track=track(Settings(**json.loads(sys.argv[1]))))
    except Refused as refused:
        say(error=str(refused), help=refused.advice)


if __name__ == "__main__":
    main()
