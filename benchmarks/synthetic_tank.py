"""A synthetic camera before a tank: `python -m benchmarks.synthetic_tank --out DIR` films throws into the true slush.

`--noise 0.3` writes tracks in place of videos, with so much noise; docs/tank-sample.csv has 50 throws of that.

The throws are those of the simulator at bench scale. Every pixel takes the colour of the tag, the bar or the water
that its ray meets, averaged over the exposure; then come noise, eight bits and H.264. Lens distortion and perspective
are those of rays. NumPy and OpenCV alone.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path

import cv2
import numpy as np
import yaml

from pipeline.bench.vision.markers_file import Dictionary, Markers, TaggedBar, markers_of
from pipeline.bench.vision.tags import charuco_board, modules
from pipeline.bench.vision.video import Picture, film
from tasks.arrays import Float32, Float64
from tasks.bench.fabrication.kit_settings import KitSettings, ThrowingKit
from tasks.bench.fabrication.throwing_bars import throwing_bars
from tasks.bench.vision.plane import Lens, SeenPlane
from tasks.residual.throws import Starts, even_starts
from tasks.seeding import generator
from tasks.simulation.free_links import FreeLinks
from tasks.world import Physics, Slush, froude_time

SCALE = 0.07  # bench metres per simulated metre
_PER_MM = 6.0  # texels of a bar's picture per millimetre
_N_INSTANTS = 8  # over which an exposure is averaged
_COARSE = 16  # pixels of the grid on which the part of a picture that shows a bar is found
_MASS = 0.098  # of a bar that is 25 mm thick [kg]
_FINE = 16  # steps of the tank in one of the base simulator
_BLANK = 0.15  # between two throws [s]
_AIR, _WATER, _PAPER, _INK = 205.0, 165.0, 240.0, 25.0  # grey levels


@dataclass(frozen=True)
class TankCamera:
    """The camera and what it does to a picture."""

    width: int = 1920
    height: int = 1080
    field: float = 1.3  # width of the tank that it sees [m]
    distance: float = 1.8  # from the tank [m]
    yaw: float = 0.08  # [rad]
    pitch: float = 0.05  # [rad]
    rate: float = 60.0  # frames per second
    exposure: float = 0.002  # [s]
    distortion: tuple[float, float, float, float, float] = (-0.12, 0.05, 0.0005, -0.0005, 0.0)
    noise: float = 2.5  # grey levels
    drop: float = 0.02  # share of the frames that the file lacks
    quality: int = 20  # constant rate factor of x264

    @property
    def lens(self) -> Lens:
        """Its lens."""
        focal = self.width * self.distance / self.field
        return Lens((focal, focal), (self.width / 2 + 4.3, self.height / 2 - 7.1), self.distortion)

    @cached_property
    def rays(self) -> Float32:
        """(height, width, 2) rays of all pixels."""
        rows, columns = np.mgrid[: self.height, : self.width]
        pixels = np.column_stack((columns.ravel(), rows.ravel())).astype(np.float64)
        return self.lens.rays(pixels).reshape(self.height, self.width, 2).astype(np.float32)

    def plane(self, middle: Sequence[float], behind: float, rotation: Float64 | None = None) -> SeenPlane:
        """Return a plane parallel to the tank's front.

        Args:
            middle: point of the tank that it looks at [m].
            behind: distance of the plane behind the front [m].
            rotation: (3, 3) rotation of the plane from x to the right and y up; the camera's own tilt by default.
        """
        cy, sy, cp, sp = np.cos(self.yaw), np.sin(self.yaw), np.cos(self.pitch), np.sin(self.pitch)
        tilt = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]]) @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        turn = np.diag([1.0, -1.0, 1.0]) @ (tilt if rotation is None else rotation)
        origin = turn @ np.array([-middle[0], -middle[1], behind]) + (0, 0, self.distance)
        return SeenPlane(self.lens, np.column_stack((turn[:, 0], turn[:, 1], origin)))


def _met(rays: Float32, plane: SeenPlane) -> Float32:
    """Return where rays meet a plane [m]."""
    back = np.linalg.inv(plane.to_rays).astype(np.float32)
    scaled = [back[i, 0] * rays[..., 0] + back[i, 1] * rays[..., 1] + back[i, 2] for i in range(3)]
    return np.stack((scaled[0] / scaled[2], scaled[1] / scaled[2]), axis=-1)


@cache
def _face(bar: TaggedBar, dictionary: Dictionary, pixel: float) -> tuple[Float32, Float32]:
    """Return a bar's face times its cover, and its cover, blurred by the footprint of a pixel [m]."""
    border = 8
    height, width = (round(1000 * _PER_MM * side) for side in (bar.length, bar.width))
    face = np.full((height + 2 * border, width + 2 * border), 0.0, np.float32)
    cover = np.zeros_like(face)
    cover[border:-border, border:-border] = 1.0
    face[border:-border, border:-border] = _PAPER
    for tag in bar.tags:
        side = round(1000 * _PER_MM * tag.size)
        black = cv2.resize(
            modules(dictionary, tag.number).astype(np.float32), (side, side), interpolation=cv2.INTER_NEAREST
        )
        top = round(face.shape[0] / 2 - 1000 * _PER_MM * tag.along - side / 2)
        left = round(face.shape[1] / 2 + 1000 * _PER_MM * tag.across - side / 2)
        face[top : top + side, left : left + side] += (_INK - _PAPER) * black
    footprint = 0.5 * 1000 * _PER_MM * pixel  # half a pixel [texels]
    return cv2.GaussianBlur(face, (0, 0), footprint), cv2.GaussianBlur(cover, (0, 0), footprint)


@dataclass(frozen=True)
class TankScene:
    """A tank in front of a camera."""

    camera: TankCamera
    markers: Markers
    behind: float = 0.003  # distance of the bars behind the front [m]
    rng: np.random.Generator = field(default_factory=lambda: generator(0, "synthetic tank"))

    @cached_property
    def middle(self) -> Float64:
        """Middle of the tank's tags [m]."""
        return np.mean([(tag.x, tag.y) for tag in self.markers.tank.corners], axis=0)

    @property
    def level(self) -> float:
        """Height of the water over the origin of the tank's tags [m]."""
        return self.markers.tank.waterline

    @cached_property
    def background(self) -> Float32:
        """The picture without a bar."""
        at = self._points(self.camera.plane(self.middle, 0.0))
        picture = np.where(at[..., 1] < self.level, _WATER, _AIR) + 12 * np.sin(9 * at[..., 0]) * np.cos(7 * at[..., 1])
        picture = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 1.0)
        tags = [(tag.number, tag.x, tag.y) for tag in self.markers.tank.corners]
        for number, x, y in tags:
            picture = self._with(picture, at, sticker(number, self.markers.tank.tag_size), np.array([[x, y, 0.0]]))
        return picture

    @cached_property
    def _bars_plane(self) -> Float32:
        return self._points(self.camera.plane(self.middle, self.behind))

    def _points(self, plane: SeenPlane) -> Float32:
        return _met(self.camera.rays, plane)

    def _with(self, picture: Float32, at: Float32, bar: TaggedBar, poses: Float64) -> Float32:
        """Draw a bar at the poses of an exposure."""
        pixel = self.camera.field / self.camera.width
        face, cover = _face(bar, self.markers.dictionary, pixel)
        reach = np.hypot(bar.length, bar.width) / 2 + 0.005 + _COARSE * pixel
        low, high = poses[:, :2].min(axis=0) - reach, poses[:, :2].max(axis=0) + reach
        inside = ((at[::_COARSE, ::_COARSE] >= low) & (at[::_COARSE, ::_COARSE] <= high)).all(axis=2)
        rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
        if not len(rows):
            return picture
        height, width = (slice(_COARSE * int(of[0]), _COARSE * (int(of[-1]) + 1)) for of in (rows, columns))
        window = height, width
        colour = np.zeros(picture[window].shape, np.float32)
        share = np.zeros_like(colour)
        for x, y, angle in poses.astype(np.float32):
            dx, dy = at[window][..., 0] - x, at[window][..., 1] - y
            c, s, texels = np.cos(angle), np.sin(angle), np.float32(1000 * _PER_MM)
            u = (c * dx + s * dy) * texels + (face.shape[1] - 1) / 2
            v = (s * dx - c * dy) * texels + (face.shape[0] - 1) / 2
            colour += cv2.remap(face, u, v, cv2.INTER_LINEAR)  # premultiplied by its cover
            share += cv2.remap(cover, u, v, cv2.INTER_LINEAR)
        drawn = picture.copy()
        drawn[window] = picture[window] * (1 - share / len(poses)) + colour / len(poses)
        return drawn

    def shot(self, shown: Sequence[tuple[TaggedBar, Float64]]) -> Picture:
        """Take a picture of bars, each at the (n, 3) poses of an exposure in the tank's frame, the last one on top."""
        picture = self.background
        for bar, poses in shown:
            picture = self._with(picture, self._bars_plane, bar, poses)
        noisy = picture + self.camera.noise * self.rng.standard_normal(picture.shape, dtype=np.float32)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def sticker(number: int, size: float) -> TaggedBar:
    """Return a tag on white paper.

    Args:
        number: of the tag.
        size: edge of its black square [m].
    """
    sheet = {"length": 1.4 * size, "width": 1.4 * size, "mass": 1.0}
    return TaggedBar.model_validate(sheet | {"tags": [{"number": number, "size": size}]})


def states_of(starts: Starts, seconds: float) -> tuple[Float32, Float64]:
    """Simulate throws into the true slush.

    Args:
        starts: initial states.
        seconds: duration at bench scale [s].

    Returns:
        (n_throws, n_steps + 1, 6) simulated states and (n_steps + 1,) times at bench scale [s].
    """
    physics = Physics(time_step=Physics().time_step / _FINE)
    step = physics.time_step * froude_time(SCALE)
    n_steps = int(np.ceil(seconds / step))
    links, states = FreeLinks(starts.length_scale, physics), [starts.state]
    for _ in range(n_steps):
        states.append(links.step(states[-1], Slush()))
    return np.stack(states, axis=1), step * np.arange(n_steps + 1)


def render(out: Path, scene: TankScene, starts: Starts, bars: Sequence[int], seconds: float) -> list[tuple[float, ...]]:
    """Film throws one after another.

    Args:
        out: the MP4 file.
        scene: tank and camera.
        starts: initial states in the simulation; x is from the middle of the tank.
        bars: the bar of each throw.
        seconds: duration of each throw [s].

    Returns:
        Rows of the truth: throw, time [s], x, y over the waterline [m], angle [rad], vx, vy [m/s], ω [rad/s] and the
        time since the throw began [s], all at bench scale, for every frame that the file holds.
    """
    camera, rows = scene.camera, []
    states, time = states_of(starts, seconds + camera.exposure)
    x_middle, speed = float(scene.middle[0]), SCALE / froude_time(SCALE)
    n_blank, n_frames = round(_BLANK * camera.rate), round(seconds * camera.rate)
    number = 0
    with film(out, width=camera.width, height=camera.height, rate=camera.rate, quality=camera.quality) as add:
        for throw, bar in enumerate(bars):
            for frame in range(-n_blank, n_frames):
                number += 1
                dropped = scene.rng.random() < camera.drop
                if dropped and number > 1:
                    continue
                opens = frame / camera.rate
                instants = opens + camera.exposure * (np.arange(_N_INSTANTS) + 0.5) / _N_INSTANTS
                path = states[throw].astype(np.float64)
                poses = np.column_stack([np.interp(instants, time, path[:, i]) for i in range(3)]) * (SCALE, SCALE, 1)
                there = poses + np.array((x_middle, scene.level, 0.0))
                shown = [] if frame < 0 else [(scene.markers.bars[bar], there)]
                add(scene.shot(shown), (number - 1) / camera.rate)
                if frame >= 0:
                    velocity = path[int(np.searchsorted(time, instants.mean())), 3:] * (
                        speed,
                        speed,
                        1 / froude_time(SCALE),
                    )
                    x, y, angle = poses.mean(axis=0)
                    rows.append((throw, (number - 1) / camera.rate, x + x_middle, y, angle, *velocity, instants.mean()))
    return rows


def film_board(out: Path, camera: TankCamera, markers: Markers, n_views: int, rng: np.random.Generator) -> None:
    """Film the printed board from several sides.

    Args:
        out: the MP4 file.
        camera: the camera.
        markers: which board it is.
        n_views: number of frames.
        rng: source of randomness of the board's poses.
    """
    board = markers.board
    size = (board.columns * board.square, board.rows * board.square)
    texels = 1000 * _PER_MM / 2
    pixels = (round(size[0] * texels), round(size[1] * texels))
    texture = charuco_board(board, markers.dictionary).generateImage(pixels, marginSize=0).astype(np.float32)
    texture = _INK + (_PAPER - _INK) / 255 * texture
    near = size[0] / camera.field / 0.55  # the board fills half of the picture
    close = replace(camera, distance=camera.distance * near, field=camera.field * near)  # with the same lens
    footprint = 0.5 * texels * close.field / camera.width
    texture = cv2.GaussianBlur(texture, (0, 0), footprint)
    with film(out, width=camera.width, height=camera.height, rate=10, quality=camera.quality) as add:
        for _ in range(n_views):
            turn, _ = cv2.Rodrigues(rng.uniform((-0.5, -0.5, -0.3), (0.5, 0.5, 0.3)))
            shift = rng.uniform(-0.25, 0.25, 2) * (close.field, close.field * camera.height / camera.width)
            at = _met(camera.rays, close.plane(np.array(size) / 2 + shift, 0.0, turn))
            u, v = at[..., 0] * np.float32(texels) - 0.5, (size[1] - at[..., 1]) * np.float32(texels) - 0.5
            picture = cv2.remap(texture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=_WATER)
            noisy = picture + camera.noise * rng.standard_normal(picture.shape, dtype=np.float32)
            add(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))


def throws_for_bars(n: int, markers: Markers, rng: np.random.Generator) -> tuple[Starts, list[int]]:
    """Return n throws designed for robots with the kit's lengths, and the bar of each."""
    starts = even_starts(n, Physics(), rng)
    lengths = np.array([bar.length for bar in markers.bars]) / SCALE
    bars = np.abs(lengths[:, None] - starts.length_scale).argmin(axis=0)
    return Starts(starts.throw, lengths[bars], starts.state), bars.tolist()


def write_tracks(
    out: Path, starts: Starts, *, seconds: float, rate: float, noise_mm: float, rng: np.random.Generator
) -> None:
    """Write tracks.csv and tracks-bars.csv: poses at frames with Gaussian noise, of angles as many degrees as mm."""
    states, time = states_of(starts, seconds)
    frames = np.arange(round(seconds * rate)) / rate
    deviation = np.array((noise_mm / 1000, noise_mm / 1000, np.radians(noise_mm)))
    bars = np.stack((starts.throw, starts.length_scale * SCALE, SCALE / starts.length_scale), axis=1)
    tracks = []
    for throw, path in zip(starts.throw, states.astype(np.float64), strict=True):
        pose = np.column_stack([np.interp(frames, time, path[:, i]) for i in range(3)]) * (SCALE, SCALE, 1)
        noisy = pose + deviation * rng.standard_normal(pose.shape)
        tracks.append(np.column_stack((np.full(len(frames), throw), frames, noisy)))
    for name, header, columns, formats in (
        ("tracks", "throw,time,x,y,angle", np.concatenate(tracks), "%d,%.5f,%.5f,%.5f,%.4f"),
        (
            "tracks-bars",
            "throw,length,width,mass",
            np.column_stack((bars, np.full(len(bars), _MASS))),
            "%d,%.4f,%.4f,%.3f",
        ),
    ):
        np.savetxt(out / f"{name}.csv", columns, formats, header=header, comments="")


def write_truth(path: Path, rows: Sequence[tuple[float, ...]]) -> None:
    """Write the truth as CSV."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("throw", "time", "x", "y", "angle", "vx", "vy", "omega", "since"))
        writer.writerows(rows)


def main() -> None:
    """Film throws and a board, and write what is true of them."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--out", type=Path, required=True)
    options.add_argument("--throws", type=int, default=4)
    options.add_argument("--seconds", type=float, default=0.5)
    options.add_argument("--rate", type=float, default=60.0)
    options.add_argument("--exposure", type=float, default=TankCamera.exposure)
    options.add_argument("--noise", type=float, help="write tracks with so much noise [mm] in place of videos")
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    throwing = ThrowingKit(tank_length=1.1, tank_height=0.62, waterline=0.32)
    markers = markers_of(throwing, throwing_bars(throwing, KitSettings(), 1000.0))
    camera = TankCamera(rate=given.rate, exposure=given.exposure)
    rng = generator(given.seed, "synthetic tank", given.rate)
    starts, bars = throws_for_bars(given.throws, markers, rng)
    if given.noise is not None:
        write_tracks(given.out, starts, seconds=given.seconds, rate=given.rate, noise_mm=given.noise, rng=rng)
        return
    rows = render(given.out / "throws.mp4", TankScene(camera, markers, rng=rng), starts, bars, given.seconds)
    write_truth(given.out / "truth.csv", rows)
    film_board(given.out / "board.mp4", camera, markers, 12, rng)
    document = yaml.safe_dump(markers.model_dump(mode="json"), sort_keys=False)
    (given.out / "markers.yaml").write_text(document, encoding="utf-8")
    print(f"{given.throws} throws of {given.seconds:g} s in {given.out}")


if __name__ == "__main__":
    main()
