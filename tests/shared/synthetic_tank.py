"""A synthetic camera before a tank: `python tests/shared/synthetic_tank.py --out DIR` films throws into the true slush.

`--noise 0.3` writes tracks in place of videos, with so much noise [mm]; docs/tank-sample.csv has 50 throws of that.
`--memory` throws them into a fluid with memory, which networks that see one instant cannot learn.

The throws are those of the simulator at bench scale. Every pixel takes the colour of the tag, the bar or the water
that its ray meets, averaged over the exposure; then come noise, eight bits and H.264. Lens distortion and perspective
are those of rays.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
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
from tasks.world import LinkStates, Medium, Physics, Slush, VelocityChange, froude_time

SCALE = 0.07  # bench metres per simulated metre
TIME = froude_time(SCALE)  # bench seconds per simulated second
UNITS = np.array((SCALE, SCALE, 1, SCALE / TIME, SCALE / TIME, 1 / TIME))  # of a state, at bench scale
_TEXELS = 6000.0  # of a bar's picture per metre
_N_INSTANTS = 4  # over which an exposure is averaged
_COARSE = 16  # pixels of the grid on which the part of a picture that shows a bar is found
_MASS = 0.098  # of a bar that is 25 mm thick [kg]
_FINE = 16  # steps of the tank in one of the base simulator
_BLANK = 0.15  # before each throw [s]
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
        focal = self.width * self.distance / self.field
        return Lens((focal, focal), (self.width / 2 + 4.3, self.height / 2 - 7.1), self.distortion)

    @cached_property
    def rays(self) -> Float32:
        """(height, width, 2) rays of all pixels."""
        rows, columns = np.mgrid[: self.height, : self.width]
        pixels = np.column_stack((columns.ravel(), rows.ravel())).astype(np.float64)
        return self.lens.rays(pixels).reshape(self.height, self.width, 2).astype(np.float32)

    def plane(self, middle: Sequence[float], behind: float, rotation: Float64 | None = None) -> SeenPlane:
        """Return a plane that is so far behind the tank's front [m], of which the camera looks at ``middle`` [m].

        ``rotation`` turns it from x to the right and y up; the camera's own tilt by default.
        """
        cy, sy, cp, sp = np.cos(self.yaw), np.sin(self.yaw), np.cos(self.pitch), np.sin(self.pitch)
        tilt = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]]) @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        turn = np.diag([1.0, -1.0, 1.0]) @ (tilt if rotation is None else rotation)
        origin = turn @ np.array([-middle[0], -middle[1], behind]) + (0, 0, self.distance)
        return SeenPlane(self.lens, np.column_stack((turn[:, 0], turn[:, 1], origin)))

    def points(self, plane: SeenPlane) -> Float32:
        """Return where the rays of all pixels meet a plane [m]."""
        scaled = self.rays @ (back := np.linalg.inv(plane.to_rays).astype(np.float32))[:, :2].T + back[:, 2]
        return scaled[..., :2] / scaled[..., 2:]

    def exposed(self, picture: Float32, rng: np.random.Generator) -> Picture:
        noisy = picture + self.noise * rng.standard_normal(picture.shape, dtype=np.float32)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


@cache
def _face(bar: TaggedBar, dictionary: Dictionary, pixel: float) -> tuple[Float32, Float32]:
    """Return a bar's face times its cover, and its cover, blurred by the footprint of a pixel [m]."""
    border = 8
    height, width = (round(_TEXELS * side) for side in (bar.length, bar.width))
    cover = np.pad(np.ones((height, width), np.float32), border)
    face = _PAPER * cover
    for tag in bar.tags:
        side, black = round(_TEXELS * tag.size), modules(dictionary, tag.number).astype(np.float32)
        top = round(face.shape[0] / 2 - _TEXELS * tag.along - side / 2)
        left = round(face.shape[1] / 2 + _TEXELS * tag.across - side / 2)
        black = cv2.resize(black, (side, side), interpolation=cv2.INTER_NEAREST)
        face[top : top + side, left : left + side] += (_INK - _PAPER) * black
    face, cover = (cv2.GaussianBlur(picture, (0, 0), 0.5 * _TEXELS * pixel) for picture in (face, cover))
    return face, cover


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
        at = self.camera.points(self.camera.plane(self.middle, 0.0))
        picture = np.where(at[..., 1] < self.level, _WATER, _AIR) + 12 * np.sin(9 * at[..., 0]) * np.cos(7 * at[..., 1])
        picture = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 1.0)
        for tag in self.markers.tank.corners:
            there = np.array([[tag.x, tag.y, 0.0]])
            picture = self._with(picture, at, sticker(tag.number, self.markers.tank.tag_size), there)
        return picture

    @cached_property
    def _bars_plane(self) -> Float32:
        return self.camera.points(self.camera.plane(self.middle, self.behind))

    def _with(self, picture: Float32, at: Float32, bar: TaggedBar, poses: Float64) -> Float32:
        """Draw a bar at the poses of an exposure."""
        pixel = self.camera.field / self.camera.width
        face, cover = _face(bar, self.markers.dictionary, pixel)
        reach = np.hypot(bar.length, bar.width) / 2 + 0.005 + _COARSE * pixel
        low, high = poses[:, :2].min(axis=0) - reach, poses[:, :2].max(axis=0) + reach
        inside = ((at[::_COARSE, ::_COARSE] >= low) & (at[::_COARSE, ::_COARSE] <= high)).all(axis=2)
        if not inside.any():
            return picture
        rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
        window = tuple(slice(_COARSE * int(of[0]), _COARSE * (int(of[-1]) + 1)) for of in (rows, columns))
        colour, share = np.zeros((2, *picture[window].shape), np.float32)
        for x, y, angle in poses.astype(np.float32):
            dx, dy = at[window][..., 0] - x, at[window][..., 1] - y
            c, s, texels = np.cos(angle), np.sin(angle), np.float32(_TEXELS)
            u = (c * dx + s * dy) * texels + (face.shape[1] - 1) / 2
            v = (s * dx - c * dy) * texels + (face.shape[0] - 1) / 2
            colour += cv2.remap(face, u, v, cv2.INTER_LINEAR)  # premultiplied by its cover
            share += cv2.remap(cover, u, v, cv2.INTER_LINEAR)
        drawn = picture.copy()
        drawn[window] = picture[window] * (1 - share / len(poses)) + colour / len(poses)
        return drawn

    def shot(self, shown: Sequence[tuple[TaggedBar, Float64]]) -> Picture:
        """Take a picture of bars, each at the (n, 3) poses of an exposure over the waterline, the last one on top."""
        picture = self.background
        for bar, poses in shown:
            picture = self._with(picture, self._bars_plane, bar, poses + np.array((0.0, self.level, 0.0)))
        return self.camera.exposed(picture, self.rng)

    def film(
        self, out: Path, n_frames: int, shown_at: Callable[[Float64], Sequence[tuple[TaggedBar, Float64]]]
    ) -> list[Float64]:
        """Film what ``shown_at`` returns for instants [s]. Returns the instants of every frame that the file holds."""
        camera, held = self.camera, []
        with film(out, width=camera.width, height=camera.height, rate=camera.rate, quality=camera.quality) as add:
            for frame in range(n_frames):
                if frame == 0 or self.rng.random() >= camera.drop:
                    opens = frame / camera.rate
                    held.append(opens + camera.exposure * (np.arange(_N_INSTANTS) + 0.5) / _N_INSTANTS)
                    add(self.shot(shown_at(held[-1])), opens)
        return held


def sticker(number: int, size: float) -> TaggedBar:
    """Return a tag of a size [m] on white paper."""
    sheet = {"length": 1.4 * size, "width": 1.4 * size, "mass": 1.0}
    return TaggedBar.model_validate(sheet | {"tags": [{"number": number, "size": size}]})


class SlushWithMemory:
    """Slush whose drag comes to one half from a Maxwell element, which follows in half a second of simulation."""

    def __init__(self) -> None:
        self._late: Float64 | float = 0.0  # drag of the element, of each link

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        drag, whole = (
            np.stack((change.vx, change.vy, change.omega))
            for gravity in (0.0, physics.gravity)
            for change in [Slush().velocity_change(links, physics.model_copy(update={"gravity": gravity}))]
        )
        self._late = np.where(drag.any(axis=0), self._late + physics.time_step / 0.5 * (drag - self._late), 0.0)
        return VelocityChange(*(whole + (self._late - drag) / 2))


def states_of(starts: Starts, seconds: float, medium: Medium | None = None) -> tuple[Float32, Float64]:
    """Simulate throws into a medium, the true slush by default, for a time at bench scale [s].

    Returns (n_throws, n_steps + 1, 6) simulated states, and (n_steps + 1,) times at bench scale [s].
    """
    physics = Physics(time_step=Physics().time_step / _FINE)
    n_steps = int(np.ceil(seconds / (physics.time_step * TIME)))
    links, states, medium = FreeLinks(starts.length_scale, physics), [starts.state], medium or Slush()
    for _ in range(n_steps):
        states.append(links.step(states[-1], medium))
    return np.stack(states, axis=1), physics.time_step * TIME * np.arange(n_steps + 1)


TRUTH = ("throw", "time", "x", "y", "angle", "vx", "vy", "omega")


def film_throws(out: Path, scene: TankScene, starts: Starts, bars: Sequence[int], seconds: float) -> Float64:
    """Film throws of a kit's bars from starts in the simulation, one after another, each for some time [s].

    Returns the columns TRUTH of every frame that the file holds, at bench scale and over the waterline.
    """
    rate = scene.camera.rate
    states, time = states_of(starts, seconds + scene.camera.exposure)
    n_blank, n_seen = round(_BLANK * rate), round(seconds * rate)

    def motion(instants: Float64) -> tuple[int, Float64] | None:
        """Return the throw and its (n_instants, 6) states; None between throws."""
        throw, frame = divmod(int(instants[0] * rate), n_blank + n_seen)
        if frame < n_blank:
            return None
        since = instants - (throw * (n_blank + n_seen) + n_blank) / rate
        state = np.column_stack([np.interp(since, time, path) for path in states[throw].T]) * UNITS
        return throw, state + np.array((scene.middle[0], 0, 0, 0, 0, 0))

    def shown_at(instants: Float64) -> list[tuple[TaggedBar, Float64]]:
        moved = motion(instants)
        return [] if moved is None else [(scene.markers.bars[bars[moved[0]]], moved[1][:, :3])]

    held = scene.film(out, len(bars) * (n_blank + n_seen), shown_at)
    shown = [(round(instants[0] * rate) / rate, *moved) for instants in held if (moved := motion(instants))]
    return np.array([(throw, opens, *state.mean(axis=0)) for opens, throw, state in shown])


def film_board(out: Path, camera: TankCamera, markers: Markers, n_views: int, rng: np.random.Generator) -> None:
    """Film the printed board of a markers file from several sides, one a frame."""
    board = markers.board
    size = (board.columns * board.square, board.rows * board.square)
    texels = _TEXELS / 2
    pixels = (round(size[0] * texels), round(size[1] * texels))
    texture = charuco_board(board, markers.dictionary).generateImage(pixels, marginSize=0).astype(np.float32)
    texture = _INK + (_PAPER - _INK) / 255 * texture
    near = size[0] / camera.field / 0.55  # the board fills half of the picture
    close = replace(camera, distance=camera.distance * near, field=camera.field * near)  # with the same lens
    texture = cv2.GaussianBlur(texture, (0, 0), 0.5 * texels * close.field / camera.width)
    with film(out, width=camera.width, height=camera.height, rate=10, quality=camera.quality) as add:
        for _ in range(n_views):
            turn, _ = cv2.Rodrigues(rng.uniform((-0.5, -0.5, -0.3), (0.5, 0.5, 0.3)))
            shift = rng.uniform(-0.25, 0.25, 2) * (close.field, close.field * camera.height / camera.width)
            at = camera.points(close.plane(np.array(size) / 2 + shift, 0.0, turn))
            u, v = at[..., 0] * np.float32(texels) - 0.5, (size[1] - at[..., 1]) * np.float32(texels) - 0.5
            picture = cv2.remap(texture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=_WATER)
            add(camera.exposed(picture, rng))


def throws_for_bars(n: int, markers: Markers, rng: np.random.Generator) -> tuple[Starts, list[int]]:
    """Return n throws designed for robots with the kit's lengths, and the bar of each."""
    starts = even_starts(n, Physics(), rng)
    lengths = np.array([bar.length for bar in markers.bars]) / SCALE
    bars = np.abs(lengths[:, None] - starts.length_scale).argmin(axis=0)
    return Starts(starts.throw, lengths[bars], starts.state), bars.tolist()


def write_csv(path: Path, names: Sequence[str], columns: Float64, formats: str) -> None:
    np.savetxt(path, columns, formats, header=",".join(names), comments="")


def write_tracks(
    out: Path,
    starts: Starts,
    *,
    seconds: float,
    noise_mm: float,
    rng: np.random.Generator,
    medium: Medium | None = None,
) -> None:
    """Write tracks.csv and tracks-bars.csv: poses at frames with Gaussian noise, of angles as many degrees as mm."""
    states, time = states_of(starts, seconds, medium)
    frames = np.arange(round(seconds * TankCamera.rate)) / TankCamera.rate
    deviation = np.array((noise_mm / 1000, noise_mm / 1000, np.radians(noise_mm)))
    tracks = []
    for throw, path in zip(starts.throw, states.astype(np.float64), strict=True):
        pose = np.column_stack([np.interp(frames, time, path[:, i]) for i in range(3)]) * UNITS[:3]
        noisy = pose + deviation * rng.standard_normal(pose.shape)
        tracks.append(np.column_stack((np.full(len(frames), throw), frames, noisy)))
    write_csv(out / "tracks.csv", TRUTH[:5], np.concatenate(tracks), "%d,%.5f,%.5f,%.5f,%.4f")
    bars = (starts.throw, starts.length_scale * SCALE, SCALE / starts.length_scale, np.full(len(starts.throw), _MASS))
    write_csv(out / "tracks-bars.csv", ("throw", "length", "width", "mass"), np.column_stack(bars), "%d,%.4f,%.4f,%.3f")


def markers_of_tank(tank: ThrowingKit) -> Markers:
    """Return the markers of a throwing kit for a tank."""
    return markers_of(tank, throwing_bars(tank, KitSettings(), 1000.0))


def main() -> None:
    """Film throws and a board, and write what is true of them; or write tracks."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--out", type=Path, required=True)
    options.add_argument("--throws", type=int, default=4)
    options.add_argument("--noise", type=float, help="write tracks with so much noise [mm] in place of videos")
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--memory", action="store_true", help="of a fluid with memory, in tracks")
    given = options.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    markers, seconds = markers_of_tank(ThrowingKit(tank_length=1.1, tank_height=0.62, waterline=0.32)), 0.5
    rng = generator(given.seed, "synthetic tank", TankCamera.rate)
    starts, bars = throws_for_bars(given.throws, markers, rng)
    if given.noise is not None:
        medium = SlushWithMemory() if given.memory else None
        write_tracks(given.out, starts, seconds=seconds, noise_mm=given.noise, rng=rng, medium=medium)
    else:
        scene = TankScene(TankCamera(), markers, rng=rng)
        truth = film_throws(given.out / "throws.mp4", scene, starts, bars, seconds)
        write_csv(given.out / "truth.csv", TRUTH, truth, "%d,%.5f,%.6f,%.6f,%.5f,%.4f,%.4f,%.4f")
        film_board(given.out / "board.mp4", scene.camera, markers, 12, rng)
        (given.out / "markers.yaml").write_text(yaml.safe_dump(markers.model_dump(mode="json"), sort_keys=False))
    print(f"{given.throws} throws of {seconds:g} s in {given.out}")


if __name__ == "__main__":
    main()
