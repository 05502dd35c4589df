"""Page in the browser on which the user picks the markers and the scale of a film.

The page holds the choice of the user and sends all of it with each request. :class:`Session` computes
proposals and trials from this choice, with the functions that ``track setup`` uses. A session does not store
the choice.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from secrets import token_urlsafe
from typing import Annotated, Any, Protocol

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from pydantic import Field

import swimid
from swimid.errors import InputError, SwimidError, UsageError
from swimid.files import yamlio
from swimid.notices import Progress, Step, record_warnings
from swimid.tracking import frames
from swimid.tracking import setup as setup_format
from swimid.tracking.frames import ColourModel, Frame, RawTrack, Video
from swimid.tracking.options import Pick, TrackSetupOptions
from swimid.tracking.pick_server import BAD_JSON, PageAnswer, PageRequest, PageServer
from swimid.tracking.proposals import kinds_of, marker_fault, pick_markers, setup_of
from swimid.tracking.setup import Marker
from swimid.tracking.tracker import follow

#: Marker that stands for the whole body.
BODY = Marker(name="body", method="background")
#: Keys of the setup that the page states, apart from those of the markers.
KEYS = ("plane", "frame_rate_hz", "scale", "ignore_px")
#: Maximum memory for the latest frames of the film, bytes, and maximum number of these frames.
KEPT_BYTES, MAX_KEPT = 200_000_000, 30
#: Maximum number of frames in one trial, and of outlines that are drawn for one marker.
MAX_TRIAL, MAX_OUTLINES = 2000, 40
POLICY = (
    "default-src 'none'; script-src 'nonce-{0}'; style-src 'nonce-{0}'; img-src blob: data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


def _no_step(amount: int = 1) -> None:
    return None


class Finish(Protocol):
    """Function that tries a setup on the whole film, and writes it."""

    def __call__(self, markers: list[Marker], common: dict[str, Any], progress: Progress) -> Any:
        """Return the draft of the setup."""


class Click(yamlio.Document):
    """Name of a marker, the pixel on which the user clicked, and the place of the marker on the robot, m."""

    name: str
    x: float
    y: float
    at_m: tuple[float, float] | None = None


class Choice(yamlio.Document):
    """Choice of the user on the page. The values of the setup keys are checked by the setup format."""

    frame: Annotated[int, Field(ge=0)] = 0
    picks: Annotated[tuple[Click, ...], Field(max_length=400)] = ()
    background: bool = False
    plane: Any = None
    frame_rate_hz: Any = None
    scale: Any = None
    ignore_px: Any = None

    @property
    def common(self) -> dict[str, Any]:
        """Keys of the setup, without the keys of the markers."""
        return {key: value for key in KEYS if (value := getattr(self, key)) is not None}


class TrialRequest(yamlio.Document):
    """Choice of the user, and the frames on which it is tried."""

    choice: Choice
    first: Annotated[int, Field(ge=0)]
    count: Annotated[int, Field(ge=1, le=MAX_TRIAL)]


class FrameReader:
    """Frames of a film by their number or time. The film is read forwards, and the latest frames are kept."""

    def __init__(self, path: Path) -> None:
        self.path, self.video = path, Video(path)
        self._kept: dict[int, Frame] = {}
        self._times: list[float] = []
        self._next, self._frames = 0, self.video.frames()
        size = self.video.width * self.video.height * 3
        self._most = int(np.clip(KEPT_BYTES // size, 2, MAX_KEPT))

    def _read(self) -> bool:
        """Read the next frame, and return whether there is one."""
        time, frame = next(self._frames, (math.nan, None))
        if frame is None:
            return False
        self._kept[self._next] = frame.copy()
        if self._next == len(self._times):
            self._times.append(time)
        self._next += 1
        if len(self._kept) > self._most:
            del self._kept[next(iter(self._kept))]
        return True

    def at(self, index: int, step: Step) -> tuple[int, float, Frame]:
        """Return number, time and picture of a frame, or of the last frame if the film is shorter."""
        if index < self._next and index not in self._kept:
            self._kept, self._next, self._frames = {}, 0, Video(self.path).frames()
        while self._next <= index and self._read():
            step()
        index = min(index, self._next - 1)
        return index, self._times[index], self._kept[index]

    def index_of(self, time_s: float, step: Step) -> int:
        """Return the number of the first frame that is not earlier than a time."""
        while not self._times or self._times[-1] < time_s:
            count = len(self._times)
            self.at(count, step)
            if len(self._times) == count:
                break
        return bisect_left(self._times, time_s)


class Session:
    """Answers to the requests of the page.

    Parameters
    ----------
    video : path
        Film.
    finish : callable
        Function that tries a setup on the whole film, and writes it.
    progress : Progress
        Shows the progress on the terminal. The page shows the same progress.
    start : dict
        Choice with which the page begins.
    target : str
        Name of the setup file, which the page states.
    """

    def __init__(
        self, video: Path, finish: Finish, progress: Progress, start: dict[str, Any], target: str
    ) -> None:
        self.reader = FrameReader(video)
        self.video = video
        self.draft: Any = None
        self.status: dict[str, Any] = {"task": "", "count": 0}
        self._finish, self._progress, self._start, self._target = finish, progress, start, target
        self._post = {"check": self.check, "try": self.attempt, "done": self.finish}

    @contextmanager
    def progress(self, description: str, total: int | None = None) -> Iterator[Step]:
        """Show the progress of a computation on the terminal and on the page."""
        with self._progress(description, total) as step, self._show_progress(description, step) as both:
            yield both

    @contextmanager
    def _show_progress(self, description: str, step: Step = _no_step) -> Iterator[Step]:
        """Show the progress of a computation on the page."""
        self.status = {"task": description, "count": 0}

        def both(amount: int = 1) -> None:
            self.status["count"] += amount
            step(amount)

        try:
            yield both
        finally:
            self.status = {"task": "", "count": 0}

    def answer(self, request: PageRequest) -> PageAnswer:
        """Return the answer to a request of the page."""
        try:
            if request.method == "POST" and request.name in self._post:
                content = self._post[request.name](request.content)
                return PageAnswer.of_json(yamlio.plain(content, finite=True), last=request.name == "done")
            if request.method == "GET" and request.name == "":
                return self._page()
            if request.method == "GET" and request.name == "frame":
                return self._frame(request.content)
        except SwimidError as error:
            return PageAnswer.of_json({"error": describe_error(error)}, 422)
        except RecursionError:
            return BAD_JSON
        return PageAnswer.of_json({"error": {"message": "no such page", "hint": None}}, 404)

    def _page(self) -> PageAnswer:
        """Return the page, with its initial choice and the properties of the film."""
        video, nonce = self.reader.video, token_urlsafe(16)
        film = {
            "name": self.video.name, "width": video.width, "height": video.height,
            "pictures": math.isnan(video.first_stamp_s), "frames": video.claimed,
            "shape": video.height / video.width / video.pixel_aspect, "aspect": video.pixel_aspect,
        }  # fmt: skip
        loader = PackageLoader("swimid.tracking", "templates")
        environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
        page = environment.get_template("pick.html").render(
            film=film,
            start=self._start,
            target=self._target,
            nonce=nonce,
            version=swimid.__version__,
            max_trial=MAX_TRIAL,
        )
        headers = {"Content-Security-Policy": POLICY.format(nonce)}
        return PageAnswer(page.encode(), "text/html; charset=utf-8", headers=headers)

    def _frame(self, query: dict[str, str]) -> PageAnswer:
        """Return one frame of the film as PNG. The header contains its number and time."""
        try:
            index, time_s = int(query.get("n", 0)), float(query.get("time", "nan"))
        except ValueError:
            index, time_s = -1, math.nan
        if index < 0:
            raise InputError(f"has no frame '{query.get('n')}'; frames are counted from 0", file=self.video)
        with self._show_progress("reading") as step:
            if math.isfinite(time_s):
                index = self.reader.index_of(time_s, step)
            index, time_s, frame = self.reader.at(index, step)
        _, data = cv2.imencode(".png", frame, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        return PageAnswer(
            data.tobytes(), "image/png", headers={"X-Frame": str(index), "X-Time": f"{time_s:.4f}"}
        )

    def check(self, content: Any) -> dict[str, Any]:
        """Return the proposals for a choice, and its errors by the part of the page that they concern."""
        choice = yamlio.validate({"choice": content}, ChoiceRequest, Path("page")).choice
        answer: dict[str, Any] = {"markers": [], "scale": None}
        errors: dict[str, Any] = {}
        with record_warnings() as notices:
            for key, value in choice.common.items():
                try:
                    body = setup_format.read_setup({"markers": [BODY], key: value})
                    if key == "scale":
                        plane = choice.plane or body.plane
                        answer["scale"] = self._scale(body.model_copy(update={"plane": plane}))
                except SwimidError as error:
                    errors[key] = describe_error(error)
            try:
                answer["markers"] = [self._proposal(marker, choice) for marker in self._markers(choice)]
            except SwimidError as error:
                errors["picks"] = describe_error(error)
        return answer | {"errors": errors, "notices": [asdict(notice) for notice in notices]}

    def attempt(self, content: Any) -> dict[str, Any]:
        """Follow the markers of a choice through some frames, and return where they were found."""
        trial = yamlio.validate(content, TrialRequest, Path("page"))
        markers, common = self._read_choice(trial.choice)
        if trial.first:
            # The start points are those of the first frame of the film.
            markers = [marker.model_copy(update={"start_px": None}) for marker in markers]
        self._read_frame(trial.first)
        within = slice(trial.first, trial.first + trial.count)
        with record_warnings() as notices, self.progress("trying") as step:
            track = follow(self.video, setup_of(markers, common), step=step, within=within).track
        return {
            "first": trial.first,
            "count": len(track.times),
            "markers": [_summarise_track(track, name) for name in track.names],
            "notices": [asdict(notice) for notice in notices],
        }

    def finish(self, content: Any) -> dict[str, Any]:
        """Try the choice on the whole film, write the setup, and return what the command prints."""
        choice = yamlio.validate({"choice": content}, ChoiceRequest, Path("page")).choice
        markers, common = self._read_choice(choice)
        self.draft = self._finish(markers, common, self.progress)
        outputs = [str(path) for path in self.draft.outputs]
        following = "".join(self.draft.next_command(path) for path in outputs[:1])
        return {"text": self.draft.text, "outputs": outputs, "next": following}

    def _markers(self, choice: Choice) -> list[Marker]:
        """Return the setup entries of the picked markers, or that of the whole body."""
        if choice.background or not choice.picks:
            return [BODY] * choice.background
        frame = self._read_frame(choice.frame)
        picks = [Pick(one.name, one.x, one.y) for one in choice.picks]
        places = {one.name: one.at_m for one in reversed(choice.picks)}
        markers = pick_markers(frame, kinds_of(picks), path=self.video, index=choice.frame)
        return [marker.model_copy(update={"at_m": places[marker.name]}) for marker in markers]

    def _read_frame(self, number: int) -> Frame:
        """Return a frame of the film; raise an error if the film is shorter."""
        index, _, frame = self.reader.at(number, _no_step)
        if index != number:
            raise InputError(f"has no frame {number}; the last frame is {index}", file=self.video)
        return frame

    def _read_choice(self, choice: Choice) -> tuple[list[Marker], dict[str, Any]]:
        """Return markers and other keys of the setup; raise the first error of the choice."""
        markers = self._markers(choice)
        if not markers:
            raise UsageError("no marker is picked", hint="click on a marker in the picture")
        setup = setup_of(markers, choice.common)
        if setup.scale is not None:
            with record_warnings():
                self._scale(setup)
        return markers, choice.common

    def _scale(self, setup: setup_format.Setup) -> dict[str, Any]:
        """Return the length of a pixel in the middle of the picture, m, and the error of the points, px."""
        plane = self.reader.video.plane(setup)
        pixel = float(plane.size_of_pixel(*plane.middle))
        return {"metres_per_pixel": pixel, "residual_px": plane.residual_px, "residual_m": plane.residual}

    def _proposal(self, marker: Marker, choice: Choice) -> dict[str, Any]:
        """Return a marker, and the outlines of all patches of its colour and size in the picked frame."""
        proposal = marker.model_dump(mode="json", exclude_none=True) | {"names": marker.names}
        if marker.hsv is None or marker.area_px is None:
            return proposal
        _, _, frame = self.reader.at(choice.frame, _no_step)
        patches = frames.find_patches(frames.marker_mask(frame, ColourModel(marker.hsv)), marker.area_px)
        outlines = [patch.contour[:, 0].tolist() for patch in patches[:MAX_OUTLINES]]
        return proposal | {"outlines": outlines, "patches": len(patches)}


class ChoiceRequest(yamlio.Document):
    """Choice of the user that is checked or written."""

    choice: Choice


def describe_error(error: SwimidError) -> dict[str, Any]:
    """Return class, message and hint of an error. The command prints the same message and hint."""
    return {"type": type(error).__name__, "message": error.message, "hint": error.hint}


def _summarise_track(track: RawTrack, name: str) -> dict[str, Any]:
    """Return the share of frames in which a marker was found, its fault, and its circle in each frame."""
    row = track.row(name)
    found = track.is_whole[row]
    table = np.column_stack([track.x[row], track.y[row], np.sqrt(track.area[row] / np.pi)]).round(2)
    circles = [circle if seen else None for circle, seen in zip(table.tolist(), found, strict=True)]
    fault = marker_fault(track, name)[1]
    return {"name": name, "share": float(found.mean()), "fault": fault, "circles": circles}


def pick(
    video: Path,
    options: TrackSetupOptions,
    common: dict[str, Any],
    finish: Finish,
    *,
    output: Path | None,
    progress: Progress,
) -> Any:
    """Serve the page until the user presses Done, and return the draft that ``finish`` made.

    Raises
    ------
    InputError
        The film cannot be read.
    UsageError
        The port cannot be used.
    """
    stated = {key: value for key, value in common.items() if value is not None}
    picks = [asdict(one) for one in options.picks]
    start = {"frame": options.frame, "picks": picks, "background": options.background, **stated}
    session = Session(video, finish, progress, start, output.name if output is not None else "")
    server = PageServer(options.port, lambda: session.status)
    server.announce(browser=options.browser)
    server.run(session.answer)
    return session.draft
