"""What is known of a recording before its motion is reckoned: rests, noise, mounting and a first attitude."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial import attitude, mounting, rest
from swimid.inertial.attitude import QUATERNIONS, Source
from swimid.inertial.faults.base import Finding
from swimid.inertial.mounting import Mount
from swimid.inertial.options import TrackImuOptions
from swimid.inertial.record import Array, Record
from swimid.inertial.rest import Noise, Rest
from swimid.inertial.sensor import (
    FILTER_SD,
    QUATERNION_SD,
    SHEET_ACCELERATION_NOISE,
    SHEET_RATE_NOISE,
    Sensor,
)

#: Where found rests lie that count as rests of the body and not only of its noise, by ``--rest``.
BELIEVED = {"ends": ("start", "end"), "all": ("start", "between", "end"), "none": ()}


@dataclass(frozen=True)
class Stillness:
    """Still stretches, which of them are rests, and the noise they tell."""

    stretches: list[Rest]
    rests: list[Rest]
    noise: Noise

    def without(self, rests: list[Rest]) -> Stillness:
        """The same less some rests, which tell nothing then."""
        stretches, left = ([r for r in some if r not in rests] for some in (self.stretches, self.rests))
        return replace(self, stretches=stretches, rests=left)


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A record, and what is known of it."""

    record: Record
    options: TrackImuOptions
    #: As stated.
    sensor: Sensor
    still: Stillness
    mount: Mount
    #: Attitude before smoothing.
    source: Source
    #: Called after each smoothing.
    advance: Callable[[], Any] = lambda: None

    @property
    def attitude_sd(self) -> float:
        """Deviation of the attitude before smoothing, rad."""
        usual = QUATERNION_SD if self.source.kind == QUATERNIONS else FILTER_SD
        return self.sensor.attitude_sd or usual

    @property
    def still_rate(self) -> Array:
        """Turn rate of the sensor in its still stretches, rad/s, shape (3,)."""
        return attitude.still_rate(self.record, self.still.stretches)

    @property
    def body(self) -> Record:
        """The record in the body's axes, as far as gravity or the user tells the mounting."""
        turn = self.mount.rotation.inv()
        return replace(
            self.record, acceleration=turn.apply(self.record.acceleration), rate=turn.apply(self.record.rate)
        )

    @property
    def attitude(self) -> Rotation:
        """Body to world before smoothing, n of them."""
        return self.source.rotation * self.mount.rotation

    def lever(self, mount: Rotation) -> Array:
        """From the sensor to the reference point, sensor axes, m, shape (3,); ``mount``: body to sensor."""
        place = self.options.lever_m
        return np.zeros(3) if place is None else np.asarray(mount.apply(-np.asarray(place)))

    def without(self, rests: list[Rest]) -> Self:
        """The same less some rests, with the attitude a filter makes then."""
        still, source = self.still.without(rests), self.source
        if source.kind != QUATERNIONS:
            source = attitude.estimate(self.record, still.stretches)
        return replace(self, still=still, source=source)


def prepare(record: Record, options: TrackImuOptions) -> tuple[Setup, list[Finding]]:
    """Rests, mounting and attitude of a record, and what was found of its mounting."""
    sensor = Sensor.of(options)
    still = _stillness(record, sensor, options)
    mount, findings = mounting.settle(
        record, still.stretches, options.mount_deg, level_at_rest=options.level_at_rest
    )
    source = attitude.estimate(record, still.stretches)
    known = Setup(record=record, options=options, sensor=sensor, still=still, mount=mount, source=source)
    return known, findings


def _stillness(record: Record, sensor: Sensor, options: TrackImuOptions) -> Stillness:
    """Find still stretches and decide which are rests."""
    named = rest.declared(record, options.still)
    free = [r for r in rest.find(record) if not any(r.first < d.last and d.first < r.last for d in named)]
    used = sorted([*named, *(r for r in free if r.at in BELIEVED[options.rests])], key=lambda r: r.first)
    still = sorted([*named, *free], key=lambda r: r.first)
    base = rest.noise(record, still) or Noise(SHEET_ACCELERATION_NOISE, SHEET_RATE_NOISE, "data sheet")
    given = sensor.acceleration_noise is not None or sensor.rate_noise is not None
    noise = Noise(
        base.acceleration if sensor.acceleration_noise is None else sensor.acceleration_noise,
        base.rate if sensor.rate_noise is None else sensor.rate_noise,
        "given" if given else base.source,
    )
    return Stillness(still, used, noise)
