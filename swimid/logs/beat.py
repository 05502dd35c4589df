"""Beat frequency of a channel, stroke of a swimmer from all its channels, and course against heading."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.logs.log import FREQUENCY_RTOL, unwrapped
from swimid.logs.sampling import has_levels, longest_even, quantum
from swimid.notices import warn

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Length of the windows in which a sine is fitted to a channel, in cycles of the sine. Successive windows
#: overlap by all but one cycle.
WINDOW_CYCLES = 2
#: Order of the polynomial that is fitted to a channel together with the sine in each window. It describes
#: drift and turns of the path, which are slower than two cycles.
DRIFT_ORDER = 3
#: Minimum number of cycles for a frequency estimate. With fewer cycles a spectral line cannot be
#: distinguished from the noise near its frequency.
MIN_CYCLES = 4.0
#: Time-bandwidth product and number of tapers of the test for a spectral line (Thomson's F test), and maximum
#: number of cycles of a record for this test. In longer records the beat frequency varies, and the comparison
#: of phases between windows is powerful enough.
BAND, N_TAPERS, MAX_LINE_CYCLES = 3.0, 5, 30.0
#: Fraction of a record at its start, and at its end, that is tapered to zero before the spectrum is computed.
TAPERED_SHARE = 0.1
#: Minimum fraction of samples of a record that are not missing, for the test for a spectral line.
MIN_KNOWN_SHARE = 0.8
#: Probability of a false detection of a beat in noise of any spectrum.
FALSE_ALARM = 0.01
#: Minimum fractions of a channel's variance about its drift that beats must explain. At least one beat of a
#: channel must reach the first fraction. Every beat must reach the second fraction, which is smaller because
#: a stroke may be weaker than its own harmonic.
MIN_SHARE, MIN_FAINT_SHARE = 0.1, 0.02
#: Maximum change of a channel during a rest before or after a swim, divided by its largest usual change; and
#: maximum fraction of a record in its active part, for a search in this part alone.
REST_SHARE, MAX_ACTIVE_SHARE = 0.5, 0.9
#: Minimum fraction of a channel's variance about its drift that its strongest line must explain, if the other
#: frequencies are left out of the search.
MIN_MAIN_SHARE = 0.8
#: Relative tolerance within which two frequencies count as equal, or one as a multiple of the other.
SAME_RTOL = 0.03
#: Maximum number of windows of a record in the linear regression of the phase over time. The windows are
#: spread over the record.
MAX_WINDOWS = 120
#: Minimum number of samples in a window of two cycles to which a sine is fitted.
MIN_SAMPLES = DRIFT_ORDER + 5
#: Ridge that is added to the covariance of a beat's phases in successive windows to make it regular. The
#: phase of a window is ignored if its amplitude, divided by the largest amplitude, is below the square root
#: of this ridge.
RIDGE = 1e-9
#: Maximum order of a harmonic that a stronger and slower motion may cause. A beat of higher order is not
#: taken for its harmonic.
MAX_HARMONIC = 5
#: Maximum ratio of two sums of squared residuals for a slow motion that counts as periodic: that of a sine
#: fit divided by that of a polynomial with as many coefficients. The polynomial describes a drift or a turn.
PERIODIC_SHARE = 0.5


@dataclass(frozen=True)
class Beat:
    """Beat: periodic component of a channel, with its frequency, amplitude and errors.

    Attributes
    ----------
    frequency_hz, stderr_hz : float
        Frequency and its standard error, Hz.
    amplitude : float
        Amplitude of the fundamental, in the unit of the channel.
    share : float
        Fraction of the variance about the drift that the fundamental explains.
    cycles : float
        Number of cycles in the record. Below :data:`MIN_CYCLES` the frequency is approximate, and
        ``stderr_hz`` and ``share`` are unknown (NaN).
    """

    frequency_hz: float
    stderr_hz: float
    amplitude: float
    share: float
    cycles: float = np.inf

    @property
    def interval_hz(self) -> tuple[float, float]:
        """95 % interval of the beat frequency, Hz.

        It is Student's interval with the number of cycles as sample size.
        """
        from scipy import special

        half = float(special.stdtrit(max(self.cycles - WINDOW_CYCLES - 1.0, 1.0), 0.975)) * self.stderr_hz
        return self.frequency_hz - half, self.frequency_hz + half

    def may_cause(self, frequency_hz: float) -> bool:
        """Return whether a beat at ``frequency_hz`` may be a harmonic of this beat."""
        return frequency_hz < (MAX_HARMONIC + 0.5) * self.frequency_hz


def contradiction(found: Beat, stated_hz: float) -> str | None:
    """Return a message on how a beat contradicts a stated frequency; None if the two frequencies agree.

    >>> contradiction(Beat(2.0, 0.01, 1.0, 0.9), 1.0)
    'beats at 2.000 ± 0.010 Hz, 2.00 times as fast'
    """
    if abs(found.frequency_hz - stated_hz) <= max(FREQUENCY_RTOL * stated_hz, 3 * found.stderr_hz):
        return None
    ratio = found.frequency_hz / stated_hz
    text = f"beats at {found.frequency_hz:.3f} ± {found.stderr_hz:.3f} Hz"
    if abs(ratio - round(ratio)) < 0.05 and ratio > 1.5:
        text += f", {ratio:.2f} times as fast"
    return text


def stated_frequency(metadata: Mapping[str, Any]) -> float | None:
    """Return the stroke frequency that the metadata of a log state, Hz; None without a positive number."""
    value = metadata.get("frequency_hz")
    if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
        return None
    return value


def stated_against_found(
    trial: str, stated_hz: float, beat: Beat | None, consequence: str
) -> dict[str, float | str | None]:
    """Return the stated and the estimated stroke frequency of a trial, Hz, and warn of a contradiction.

    Parameters
    ----------
    beat : Beat or None
        Beat of the heading.
    consequence : str
        Clause of the warning that says which of the two frequencies the caller uses.
    """
    found: dict[str, float | str | None] = {"stated_hz": stated_hz, "found_hz": None, "stderr_hz": None}
    if beat is not None:
        found |= {"found_hz": beat.frequency_hz, "stderr_hz": beat.stderr_hz}
        if against := contradiction(beat, stated_hz):
            text = f"the heading {against}, the trials file says {stated_hz:g} Hz; {consequence}"
            warn("SWM032", f"{trial}: {text}")
    return found


def find_beat(
    time_s: Array, values: Array, *, lowest_hz: float | None = None, highest_hz: float | None = None
) -> Beat | None:
    """Return the strongest beat of a channel, by :func:`find_beats`; None if there is no beat."""
    return next(iter(find_beats(time_s, values, lowest_hz=lowest_hz, highest_hz=highest_hz)), None)


def find_beats(
    time_s: Array, values: Array, *, lowest_hz: float | None = None, highest_hz: float | None = None
) -> list[Beat]:
    """Find the periodic components (beats) of a channel, without harmonics of the strongest one.

    The strongest beat is the first in the list.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Uneven steps and NaN are allowed.
    lowest_hz, highest_hz : float, optional
        Range of the search, by default from :data:`MIN_CYCLES` cycles in the record up to about half the
        sample rate. Frequencies with fewer cycles are never searched.

    Returns
    -------
    list of Beat
        Beats found. The list is empty if the record is too short, if no motion keeps its phase from window to
        window, or if the beats may be harmonics of a stronger motion of fewer than :data:`MIN_CYCLES` cycles.
        Each beat explains at least :data:`MIN_FAINT_SHARE` of the variance about the drift.

    Notes
    -----
    Candidates are the peaks of the Lomb-Scargle spectra of the channel and of its first two derivatives. A
    sine at each candidate frequency is fitted together with a cubic polynomial in windows of two cycles. The
    polynomial removes drift and turns, and harmonics are orthogonal to the sine.

    A beat keeps its phase from window to window. For noise of any spectrum, the squared coherence between the
    amplitudes of windows that do not overlap has a Beta(1, m - 1) distribution, with m independent pairs
    (Goodman 1963). The coherence of a beat must exceed the quantile of this distribution, corrected for the
    number of frequencies in the search. In a record of few cycles, Thomson's F test (1982) is an alternative.
    For a beat whose frequency wanders, the phase of each window is compared with the mean of its neighbours.
    For the strongest line of a channel, only the frequencies of similar power count in the correction. If the
    channel rests at the ends of the record, the part between the rests is searched first.

    The frequency is the slope of the phases over time, by generalised least squares. The errors of the phases
    are noise and a random walk. The ratio of the two variances is estimated by restricted maximum likelihood.
    The standard error is therefore small for a constant frequency and larger for a varying one.
    """
    there = np.isfinite(values) & np.isfinite(time_s)
    t, x = time_s[there], values[there]
    if len(t) < 2 * MIN_SAMPLES:
        return []
    active = _active_part(x)
    if np.ptp(active) < MAX_ACTIVE_SHARE * len(x):
        part = slice(*active)
        of_part = find_beats(t[part], x[part], lowest_hz=lowest_hz, highest_hz=highest_hz)
        if of_part:
            return of_part
    duration, step = t[-1] - t[0], float(np.median(np.diff(t)))
    low = max(lowest_hz or 0.0, MIN_CYCLES / duration)
    # Limit the range of the search: an unevenly sampled record determines no more frequencies than an evenly
    # sampled record of as many samples.
    high = min(highest_hz or 0.45 / step, low + 2 * len(t) / duration)
    if high <= low or np.ptp(x) <= 1e-12 * np.max(np.abs(x)):
        return []
    peaks, main, number = _peaks(t, x, low, high, duration)
    tested = [_test(t, x, frequency, duration) for frequency in peaks]
    found = [result for result in tested if result is not None]
    limit = FALSE_ALARM / max(duration * (high - low), 1.0)
    sure = [beat for chance, beat in found if chance < limit]
    # The strongest line of the spectrum competes with few other frequencies if it holds most of the power.
    sure += [
        beat
        for chance, beat in found
        if limit <= chance < FALSE_ALARM / number
        and abs(beat.frequency_hz - main) < 1.0 / duration
        and beat.share > MIN_MAIN_SHARE
        and beat.cycles > 1.5 * MIN_CYCLES
    ]
    slow = _slow_motion(t, x) if lowest_hz is None else None
    if has_levels(x):
        # Remove beats that are harmonics of jumps between levels. A signal with jumps has harmonics of any
        # order, but at most half as many cycles as jumps.
        jumps = np.count_nonzero(np.diff(x))
        sure = [beat for beat in sure if 2.0 * beat.cycles <= jumps + 1.0]
    if slow is not None:
        fastest = slow.amplitude * slow.frequency_hz
        sure = [
            beat
            for beat in sure
            if beat.amplitude * beat.frequency_hz > fastest or not slow.may_cause(beat.frequency_hz)
        ]
    large = [beat for beat in sure if beat.share >= MIN_SHARE]
    if not large:
        return []
    largest = max(large, key=lambda beat: beat.amplitude)
    # The largest beat may be the second or third harmonic of the stroke. Therefore a detected beat at one
    # half or one third of its frequency has precedence.
    below = [
        beat
        for _, beat in found
        if any(abs(k * beat.frequency_hz - largest.frequency_hz) < 1.0 / duration for k in (2, 3))
    ]
    first = max(below, key=lambda beat: beat.amplitude, default=largest)
    # Leave out multiples of the first beat, and beats near its frequency, from which windows of two cycles
    # cannot separate them.
    others = [
        beat
        for beat in sure
        if abs(beat.frequency_hz - first.frequency_hz) > beat.frequency_hz / WINDOW_CYCLES
        and not multiple(beat, first, 1.0 / duration)
    ]
    return [first, *sorted(others, key=lambda beat: -beat.amplitude)]


def _active_part(values: Array) -> tuple[int, int]:
    """Return the first index and the last index + 1 of the part of a channel without rests at its ends.

    The channel rests where its change over a hundredth of the record is small.
    """
    lag = max(len(values) // 100, 1)
    change = np.abs(values[lag:] - values[:-lag])
    moves = np.flatnonzero(change >= REST_SHARE * np.percentile(change, 99))
    return int(moves[0]), int(moves[-1]) + lag + 1


def _slow_motion(time_s: Array, values: Array) -> Beat | None:
    """Return a channel's strongest motion if it is periodic but has too few cycles for a beat; else None.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Uneven steps and NaN are allowed.

    Notes
    -----
    A sine and a parabola are fitted together, at every frequency up to 1.5 times :data:`MIN_CYCLES` cycles
    per record. The sum of squared residuals is compared with that of a polynomial of order 5, which has as
    many coefficients.
    """
    there = np.flatnonzero(np.isfinite(values) & np.isfinite(time_s))
    there = there[:: max(len(there) // 1000, 1)]
    t, x = time_s[there], values[there]
    if len(t) < 2 * MIN_SAMPLES or not np.ptp(x) > 1e-12 * np.max(np.abs(x)):
        return None
    duration = float(t[-1] - t[0])
    u = 2.0 * (t - t[0]) / duration - 1.0
    powers = np.polynomial.legendre.legvander(u, 5)
    parabola, quintic = (np.linalg.qr(powers[:, :k])[0] for k in (3, 6))
    x = x - parabola @ (parabola.T @ x)
    cycles = np.arange(1.0, 1.5 * MIN_CYCLES, 0.1)
    turns = np.exp(2j * np.pi * cycles[:, None] * (t - t[0]) / duration)
    sines = np.stack([turns.real, turns.imag], axis=-1)
    sines -= parabola @ (parabola.T @ sines)
    normal = sines.transpose(0, 2, 1) @ sines
    right = sines.transpose(0, 2, 1) @ x
    weights = np.linalg.solve(normal, right[..., None])[..., 0]
    explained = np.sum(right * weights, axis=1)
    best = int(np.argmax(explained))
    drift = float(np.sum((x - quintic @ (quintic.T @ x)) ** 2))
    periodic = float(x @ x) - explained[best] < PERIODIC_SHARE * drift
    if best == 0 or cycles[best] >= MIN_CYCLES or not periodic:
        return None
    amplitude = float(np.hypot(*weights[best]))
    return Beat(cycles[best] / duration, np.nan, amplitude, np.nan, float(cycles[best]))


def waves(t: Array, frequency_hz: float, harmonics: Iterable[int] = (1,)) -> Array:
    """Return cosine and sine of each harmonic of a frequency, shape (n, 2 k), at times in s, shape (n,)."""
    turn = 2 * np.pi * frequency_hz * t
    return np.column_stack([wave(k * turn) for k in harmonics for wave in (np.cos, np.sin)])


def multiple(beat: Beat, of: Beat, resolution_hz: float = 0.0) -> int:
    """Return the ratio of two beat frequencies if it is a whole number; 0 if it is not.

    The ratio need be a whole number only within the errors of the frequencies. ``resolution_hz`` is a minimum
    of this tolerance, Hz.
    """
    order = round(beat.frequency_hz / of.frequency_hz)
    error = 3.0 * float(np.hypot(beat.stderr_hz, order * of.stderr_hz))
    off = abs(beat.frequency_hz - order * of.frequency_hz)
    return order if off <= max(SAME_RTOL * of.frequency_hz, error, resolution_hz) else 0


def _peaks(t: Array, x: Array, low: float, high: float, duration: float) -> tuple[list[float], float, float]:
    """Return the frequencies of spectral peaks in a channel and in its first two derivatives.

    The second result is the frequency of the strongest peak of the channel, and the third the number of
    frequencies with a power like that of this peak (the participation ratio of the spectrum).
    """
    # Begin the frequency grid below ``low``, so that the flank of the spectral peak of a slower motion is not
    # taken for a peak.
    grid = np.arange(max(low - 3.0 / duration, 1.0 / duration), high, 0.1 / duration)
    if len(grid) < 4:
        return [], 0.0, np.inf
    centred = t - t.mean()
    level = x - np.polyval(np.polyfit(centred / duration, x, 3), centred / duration)
    from_end = np.minimum(np.arange(len(x)), np.arange(len(x))[::-1]) / (len(x) - 1)
    tapered = level * (0.5 - 0.5 * np.cos(np.pi * np.minimum(from_end / TAPERED_SHARE, 1.0)))
    power = _power(t, tapered - tapered.mean(), grid)
    chosen: list[float] = []
    for spectrum in (power * grid**4, power * grid**2, power):
        rises = np.diff(spectrum) > 0
        tops = [k for k in np.flatnonzero(rises[:-1] & ~rises[1:]) + 1 if grid[k] >= low]
        ranked = sorted(tops, key=lambda k: -spectrum[k])[:6]
        chosen += [float(grid[k]) for k in ranked if all(abs(grid[k] - f) > 0.5 / duration for f in chosen)]
    power = np.where(grid >= low, power, 0.0)
    number = 0.1 * np.sum(power) ** 2 / max(float(power @ power), 1e-300)
    return chosen, float(grid[np.argmax(power)]), max(float(number), 1.0)


def _test(t: Array, x: Array, frequency: float, duration: float) -> tuple[float, Beat] | None:
    """Return the probability that noise passes the test for a beat at a frequency, and the beat found there.

    The result is None if the channel has no beat at this frequency.
    """
    windows = demodulate(t, x, frequency)
    if windows is None:
        return None
    time, amplitude, share, width, hop = windows
    chance = 3.0 * min(*_incoherent(time, amplitude, width, hop), _no_line(t, x, frequency))
    if chance >= FALSE_ALARM or share < MIN_FAINT_SHARE:
        return None
    size = np.abs(amplitude)
    slope, stderr = _slope(time, np.unwrap(np.angle(amplitude)), size)
    found = frequency + slope / (2 * np.pi)
    beat = Beat(found, stderr / (2 * np.pi), float(np.mean(size)), share, found * duration)
    # Accept the beat only if the number of cycles in the record is known with an error below one. Phases that
    # drift by a cycle over the record belong to another frequency.
    resolved = beat.interval_hz[1] - found < 1.0 / duration
    return (chance, beat) if resolved and abs(found - frequency) < 1.0 / duration else None


def demodulate(t: Array, x: Array, frequency: float) -> tuple[Array, Complex, float, float, float] | None:
    """Fit a sine of given frequency and a polynomial to a channel, in each window of two cycles.

    Parameters
    ----------
    t, x : ndarray, shape (n,)
        Times, s, and values without NaN.
    frequency : float
        Frequency of the sine, Hz.

    Returns
    -------
    time, amplitude : ndarray, shape (m,)
        Middle of each window, s, and complex amplitude in the unit of the channel. Windows with a negligible
        amplitude have no phase and are left out.
    share : float
        Fraction of the variance about the polynomial that the sine explains.
    width, hop : float
        Duration of a window, and time between successive windows, s. The result is None if fewer than three
        windows are left.
    """
    # At a low sample rate the windows must be longer than two cycles, so that they hold enough samples.
    step = float(np.median(np.diff(t)))
    hop = max(1.0, np.ceil(MIN_SAMPLES * step * frequency / WINDOW_CYCLES)) / frequency
    width = WINDOW_CYCLES * hop
    count = int((t[-1] - t[0] - width) / hop * (1 + 1e-9)) + 1
    if count < 3:
        return None
    starts = t[0] + hop * np.arange(count)
    if count > MAX_WINDOWS:
        # Limit the number of windows: select pairs of successive windows that do not overlap, spread over the
        # record.
        first = np.linspace(0, count - WINDOW_CYCLES - 1, MAX_WINDOWS // 2).astype(int)
        starts = starts[np.unique(np.concatenate((first, first + WINDOW_CYCLES)))]
    ends = np.searchsorted(t, np.column_stack((starts, starts + width)))
    enough = ends[:, 1] - ends[:, 0] >= max(MIN_SAMPLES, 0.5 * width / step)
    if enough.sum() < 3:
        return None
    time = starts[enough] + 0.5 * width
    amplitude, share = _fitted(t, x, ends[enough], time, width, frequency)
    carries = np.abs(amplitude) > np.sqrt(RIDGE) * np.max(np.abs(amplitude))
    if carries.sum() < 3:
        return None
    return time[carries], amplitude[carries], share, width, hop


def _incoherent(time: Array, amplitude: Complex, width: float, hop: float) -> tuple[float, float]:
    """Return the probabilities that noise has at least the observed coherence of amplitudes between windows.

    The first one is for a constant frequency: successive windows have equal phases. The second one is for a
    wandering frequency: the phase of each window is the mean of those before and after it.
    """
    after = np.searchsorted(time, time + width - 0.5 * hop)
    pairs = [
        (i, int(j)) for i, j in enumerate(after) if j < len(time) and time[j] - time[i] < width + 0.1 * hop
    ]
    if len(pairs) < 2:
        return 1.0, 1.0
    i, j = np.array(pairs).T
    following = dict(pairs)
    threes = np.array([(i, j, following[j]) for i, j in pairs if j in following], dtype=int).reshape(-1, 3).T
    before, middle, later = amplitude[threes]
    chances = []
    for one, other in ((amplitude[i], amplitude[j]), (middle**2, before * later)):
        size = float(np.sqrt(np.sum(np.abs(one) ** 2) * np.sum(np.abs(other) ** 2)))
        coherence = min(abs(np.vdot(one, other)) / max(size, 1e-300), 1.0)
        # Count a window that overlaps another window by one half as two thirds of an independent window.
        chances.append(float((1.0 - coherence**2) ** max(len(one) * 2.0 / 3.0 - 1.0, 0.0)))
    return chances[0], chances[1]


@lru_cache(maxsize=1)
def _slepian_tapers(count: int) -> Array:
    """Return the tapers that concentrate a spectral line within :data:`BAND` cycles per record.

    They are discrete prolate spheroidal sequences, shape (N_TAPERS, count). Do not change the array: the last
    one is kept, because the channels of a log have the same count.
    """
    from scipy.linalg import eigh_tridiagonal

    k = np.arange(count)
    diagonal = ((count - 1) / 2 - k) ** 2 * np.cos(2 * np.pi * BAND / count)
    largest = (count - N_TAPERS, count - 1)
    return eigh_tridiagonal(diagonal, k[1:] * (count - k[1:]) / 2, select="i", select_range=largest)[1].T


def _no_line(t: Array, x: Array, frequency: float) -> float:
    """Return the p-value of a spectral line at a frequency, against noise with a flat spectrum near it.

    This is Thomson's F test, applied to the amplitudes under orthogonal tapers. The spectrum must be flat
    within :data:`BAND` cycles per record on either side. The frequency of the line may differ by a tenth of a
    cycle per record.
    """
    duration = float(t[-1] - t[0])
    if frequency * duration > MAX_LINE_CYCLES:
        return 1.0
    count = round(duration / float(np.median(np.diff(t)))) + 1
    even = np.linspace(t[0], t[-1], count)
    u = 2.0 * (even - t[0]) / duration - 1.0
    values = np.interp(even, t, x)
    # Fill gaps of more than a quarter of a cycle with the fitted sine and polynomial.
    after = np.clip(np.searchsorted(t, even), 1, len(t) - 1)
    known = t[after] - t[after - 1] <= 0.25 / frequency
    if known.mean() < MIN_KNOWN_SHARE:
        return 1.0
    design = np.column_stack((np.vander(u, DRIFT_ORDER + 1), waves(even, frequency)))
    weights = np.linalg.lstsq(design[known], values[known], rcond=None)[0]
    values = np.where(known, values, design @ weights)
    values = values - np.polyval(np.polyfit(u, values, DRIFT_ORDER), u)
    tapers = _slepian_tapers(count)
    sums = tapers.sum(axis=1)
    best = 0.0
    for near in frequency + np.array([-0.1, -0.05, 0.0, 0.05, 0.1]) / duration:
        tapered = tapers @ (values * np.exp(-2j * np.pi * near * (even - t[0])))
        line = sums @ tapered / (sums @ sums)
        left = float(np.sum(np.abs(tapered - line * sums) ** 2))
        best = max(best, (N_TAPERS - 1) * abs(line) ** 2 * float(sums @ sums) / max(left, 1e-300))
    best *= float(known.mean())
    # The p-value is the survival function of the F distribution with 2 and 2 (N_TAPERS - 1) degrees of
    # freedom.
    return float((1.0 + best / (N_TAPERS - 1)) ** (1 - N_TAPERS))


def _fitted(
    t: Array, x: Array, ends: NDArray[np.intp], middles: Array, width: float, frequency: float
) -> tuple[Complex, float]:
    """Fit a sine and a polynomial in each window; return the sine's amplitudes and fraction of variance."""
    rows = ends[:, :1] + np.arange(int(np.max(ends[:, 1] - ends[:, 0])))
    inside = rows < ends[:, 1:]
    rows = np.minimum(rows, len(t) - 1)
    u = (t[rows] - middles[:, None]) / (0.5 * width)
    drift = [np.polynomial.legendre.legval(u, np.eye(DRIFT_ORDER + 1)[k]) for k in range(DRIFT_ORDER + 1)]
    phase = 2 * np.pi * frequency * (t[rows] - t[0])
    design = np.stack([*drift, np.cos(phase), -np.sin(phase)], axis=-1) * inside[..., None]
    values = np.where(inside, x[rows] - np.mean(x[rows], axis=1, keepdims=True), 0.0)
    normal = np.einsum("wli,wlj->wij", design, design)
    normal += 1e-12 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(normal.shape[1])
    right = np.einsum("wli,wl->wi", design, values)[..., None]
    weights = np.linalg.solve(normal, right)[..., 0]
    amplitude = weights[:, DRIFT_ORDER + 1] + 1j * weights[:, DRIFT_ORDER + 2]
    # Compute the variance that the sine explains in addition to the drift.
    d = DRIFT_ORDER + 1
    level = np.linalg.solve(normal[:, :d, :d], right[:, :d])
    drifted = float(np.sum(right[:, :d] * level))
    whole = float(np.sum(values**2)) - drifted
    return amplitude, (float(np.sum(right[..., 0] * weights)) - drifted) / max(whole, 1e-300)


def _slope(time: Array, phase: Array, size: Array) -> tuple[float, float]:
    """Return the slope of phases over time, rad/s, and its standard error, by restricted maximum likelihood.

    The covariance of the phases is the sum of two terms: white noise in overlapping windows, relative to the
    amplitudes, and a random walk. The ratio of the two variances is chosen to maximise the likelihood.
    """
    from scipy.linalg import eigh

    n = len(time)
    hop = float(np.min(np.diff(time)))
    hops = np.abs(time[:, None] - time[None, :]) / hop
    small = np.mean(size) / size
    noise = np.clip(1.0 - hops / WINDOW_CYCLES, 0.0, 1.0) * np.outer(small, small)
    walk = (np.minimum.outer(time, time) - time[0]) / hop
    # Transform to coordinates in which the covariances of noise and random walk are both diagonal.
    shares, axes = eigh(walk, noise + RIDGE * np.eye(n))
    design = axes.T @ np.column_stack((np.ones(n), time - time.mean()))
    turned = axes.T @ phase
    fits = []
    for ratio in (0.0, *np.logspace(-4, 4, 25)):
        cover = 1.0 + ratio * np.maximum(shares, 0.0)
        scaled = design / cover[:, None]
        (a, b), (_, d) = inner = design.T @ scaled
        determinant = a * d - b * b
        weights = np.linalg.solve(inner, scaled.T @ turned)
        variance = float(np.sum((turned - design @ weights) ** 2 / cover)) / max(n - 2, 1)
        misfit = (n - 2) * np.log(max(variance, 1e-300)) + float(np.sum(np.log(cover))) + np.log(determinant)
        fits.append((misfit, float(weights[1]), float(np.sqrt(max(variance, 0.0) * a / determinant))))
    return min(fits)[1:]


def _power(t: Array, x: Array, grid: Array) -> Array:
    """Return the periodogram of a record at given frequencies, by FFT if the time steps are even."""
    steps = np.diff(t)
    step = float(np.mean(steps))
    if np.ptp(steps) > 1e-3 * step:
        from scipy.signal import lombscargle

        # The frequencies are split into blocks, because scipy builds an array with one element per frequency
        # and sample.
        parts = np.array_split(2 * np.pi * grid, 1 + len(t) * len(grid) // 1_000_000)
        return np.concatenate([lombscargle(t, x, part) for part in parts])
    count = 1 << int(np.ceil(np.log2(20 * len(x))))
    return np.interp(grid, np.fft.rfftfreq(count, step), np.abs(np.fft.rfft(x, count)) ** 2)


# ---------------------------------------------------------------- stroke from all channels

#: Pattern of the channels that oscillate once per stroke, because their signs in the two half strokes are
#: opposite.
SIDEWAYS = re.compile(
    r"(joint|cmd|fin|tail)\w*(?<!_likelihood)(?<!_area_px)|yaw_rad|yaw_rate_rad_s|roll_rad|pitch_rad|"
    r"pitch_rate_rad_s|v_m_s|w_m_s|w[xyz]_rad_s|ay_m_s2|sway"
)
#: Pattern of the channels that may oscillate twice per stroke, because the robot is pushed forward in both
#: half strokes.
PUSHED = re.compile(r"u_m_s|a[xz]_m_s2|force_N")
#: Pattern of the channels that show the drive: commands, and angles of joints, fins and tail. If one of them
#: is logged, its frequency is taken for the stroke frequency.
DRIVEN = re.compile(r"cmd\w*|(joint|fin|tail)\w*_rad(_s)?")
#: Names of the channels returned by :func:`swing` that may oscillate twice per stroke.
ALONG = ("surge", "long_axis", "short_axis")
#: Pattern of the channels that show a sideways motion of the body.
MOVED = re.compile(r"sway|v_m_s|w_m_s|ay_m_s2|(joint|fin|tail)\w*_(m|px)")
#: Patterns of the channels, one for each kind of motion (heading, sway, ...). Several channels of the same
#: kind of motion count once.
_TURNED = (r"yaw_\w+|wz_rad_s", r"roll_rad|wx_rad_s", r"pitch_\w+|wy_rad_s")
_AHEAD = rf"{PUSHED.pattern}|surge|\w+_axis"
MOTIONS = tuple(map(re.compile, (DRIVEN.pattern, MOVED.pattern, *_TURNED, _AHEAD)))
#: Pattern of the columns that are not searched for a stroke: positions (see :func:`swing`), standard
#: deviations, likelihoods and states.
NO_MOTION = re.compile(
    r"[xyz](_raw)?_(m|px)|sd_.*|.*_sd(_.*)?|.*likelihood|.*confidence|.*area_px|interpolated|status|frame"
)
#: Maximum ratio of the smaller to the larger of the two counter-rotating components of a periodic path that
#: counts as a lap. For an ellipse with half axes a and b the ratio is (a - b) / (a + b). Below the maximum
#: the circular component of the path has more power than the linear component.
MAX_LAP_RATIO = np.sqrt(2.0) - 1.0
#: Maximum order of a harmonic that laps of the path cause (a rectangular pool has four corners), and maximum
#: order of a harmonic that rotation causes in a compass heading. The deviation of a compass has one or two
#: periods per rotation (semicircular and quadrantal deviation).
MAX_LAP_HARMONIC, MAX_COMPASS_HARMONIC = 4, 2
#: Maximum frequency of a stroke, Hz. Faster motion is taken for vibration. Bainbridge (J. Exp. Biol. 35,
#: 1958) found 25 Hz for dace of 5 cm and 20 Hz for dace of 8 cm.
MAX_STROKE_HZ = 20.0
#: Maximum sample rate in the search for a beat, Hz. Channels with a higher rate are averaged over blocks of
#: samples.
MAX_RATE_HZ = 60.0
#: Minimum fraction of a channel's samples in its longest gap-free segment, and maximum number of samples of a
#: channel. If the segment has this fraction, only the segment is searched for a beat. Otherwise all samples
#: are searched, unless there are more than the maximum.
MIN_STRETCH_SHARE, MAX_SAMPLES = 0.8, 20_000


@dataclass(frozen=True)
class Rhythm:
    """Stroke that was found in a log, and the channels in which it was found.

    Attributes
    ----------
    beat : Beat
        Beat of the channel whose frequency has the smallest standard error.
    channel : str
        Name of the channel of ``beat``.
    channels : dict of str to Beat
        Strongest beat of each channel that has a beat.
    maybe_double : bool
        Whether the stroke is seen only in channels that may oscillate twice per stroke, so that the frequency
        may be twice that of the stroke.
    rivals : dict of str to Beat
        Largest beat of each channel whose frequency is no multiple of the stroke frequency. Such a beat
        contradicts the stroke.
    """

    beat: Beat
    channel: str
    channels: dict[str, Beat]
    maybe_double: bool
    rivals: dict[str, Beat] = field(default_factory=dict)

    @property
    def doubt(self) -> str:
        """Reason to doubt this stroke, as text for a message; empty if there is no reason."""
        said = []
        if self.rivals:
            others = " and ".join(f"{n} at {b.frequency_hz:.4g} Hz" for n, b in self.rivals.items())
            said.append(
                f"{self.channel} beats at {self.beat.frequency_hz:.4g} Hz, {others}, which is no multiple of "
                "it: one of them is not the stroke but another vibration or sway"
            )
        if self.beat.frequency_hz > MAX_STROKE_HZ:
            hz = self.beat.frequency_hz
            said.append(f"{hz:.4g} Hz is faster than robots and all but very small fish beat")
        return "; ".join(said)


def swing(columns: Mapping[str, Array], share: float = 1.0 / MIN_CYCLES) -> dict[str, Array]:
    """Return the oscillation of a track about its averaged path, in the unit of the track.

    Parameters
    ----------
    columns : mapping of str to ndarray, each shape (n,)
        Columns with two of ``x_m``, ``y_m``, ``z_m`` (or the same in ``_px``). A single coordinate is
        returned as ``surge``.
    share : float
        Fraction of the samples over which the path is averaged. By default this is one cycle of the slowest
        stroke that is searched for.

    Returns
    -------
    dict of str to ndarray
        Components of the oscillation: ``sway`` across the averaged path and ``surge`` along this path. For a
        body that stays in place, ``long_axis`` and ``short_axis``. Empty without a track.
    """
    axes = _coordinates(columns)
    if not axes:
        return {}
    place = np.column_stack(axes)
    there = np.isfinite(place).all(axis=1)
    if there.sum() < 16 or not np.ptp(place[there], axis=0).any():
        return {}
    if place.shape[1] == 1:
        return {"surge": place[:, 0]}
    width = max(int(there.sum() * share) | 1, 5)
    path, tangent = _averaged_path(place[there], width)
    about = place[there] - path
    ways = ("surge", "sway")
    if np.median(np.linalg.norm(tangent, axis=1)) * width < 2.0 * float(np.sqrt(np.mean(about**2))):
        ways = ("long_axis", "short_axis")
        tangent = np.broadcast_to(np.linalg.svd(about, full_matrices=False)[2][0], about.shape)
    tangent = tangent / np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
    normal = np.column_stack((-tangent[:, 1], tangent[:, 0]))
    found = {way: np.full(len(place), np.nan) for way in ways}
    for way, axis in zip(ways, (tangent, normal), strict=True):
        found[way][there] = np.sum(about * axis, axis=1)
    return found


#: Number of products above which a convolution is computed by FFT. Below it the import of SciPy takes longer.
LONG_PRODUCT = 100_000_000


def _averaged_path(place: Array, width: int) -> tuple[Array, Array]:
    """Return values and slopes of straight lines fitted to ``width`` samples around each sample of a path.

    The slopes are per sample. Within half a window of either end of the path, the line of the first or last
    complete window is used.
    """
    convolve: Callable[..., Array] = np.convolve
    if width * len(place) > LONG_PRODUCT:
        # The window is a share of the log, so that its products grow with the square of the length.
        convolve = import_module("scipy.signal").convolve

    half = width // 2
    offsets = np.arange(-half, half + 1)
    middles = np.column_stack([convolve(x, np.full(width, 1 / width), "valid") for x in place.T])
    slopes = np.column_stack([convolve(x, -offsets / (offsets @ offsets), "valid") for x in place.T])
    samples = np.arange(len(place))
    line = np.clip(samples - half, 0, len(middles) - 1)
    beyond = samples - half - line
    return middles[line] + slopes[line] * beyond[:, None], slopes[line]


def coordinates(columns: Mapping[str, Array]) -> list[str]:
    """Return the names of the position columns of a log: those in metres, or if there are none, in pixels."""
    metres, pixels = ([n for n in (f"x_{u}", f"y_{u}", f"z_{u}") if n in columns] for u in ("m", "px"))
    return metres or pixels


def _coordinates(columns: Mapping[str, Array]) -> list[Array]:
    """Return the samples of a log's first two position columns, or of the only one; empty without any."""
    return [columns[name] for name in coordinates(columns)[:2]]


def find_stroke(
    time_s: Array,
    columns: Mapping[str, Array],
    *,
    range_hz: tuple[float, float] | None = None,
    stated_hz: float | None = None,
) -> Rhythm | None:
    """Find the stroke of a swimmer (its beat frequency) in the channels of a log; return None without one.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Sample times, s.
    columns : mapping of str to ndarray, each shape (n,)
        Channels with names of the log format; NaN where missing.
    range_hz : (float, float), optional
        Lowest and highest frequency of the search, Hz.
    stated_hz : float, optional
        Stated frequency of the drive, Hz. If the search over all frequencies finds nothing, a search near
        this frequency follows, which needs less evidence.

    Notes
    -----
    If the drive is logged, the stroke frequency is the frequency of the drive. Otherwise it is the frequency
    found in most kinds of motion (heading, sway, ...). A motion at twice the frequency also counts, because
    surge and drag follow both half strokes. If two frequencies are found in equally many kinds of motion, the
    one that moves the body to the side is chosen: an oscillating heading moves every point except the pivot,
    but the vibration of a sensor does not move the body.

    The returned frequency is the estimate from the channel with the smallest standard error. Estimates are
    not averaged, because the channels are not independent. Beats that contradict the stroke are stored in
    :attr:`Rhythm.rivals`, unless the frequency equals the stated one.
    """
    ranges = [range_hz]
    if stated_hz is not None and range_hz is None:
        ranges.append(((1 - FREQUENCY_RTOL) * stated_hz, (1 + FREQUENCY_RTOL) * stated_hz))
    for within in ranges:
        seen = _motions(time_s, columns, within)
        pushed = {n: b for n, b in seen.items() if PUSHED.fullmatch(n) or n in ALONG}
        beats = {n: b for n, b in seen.items() if SIDEWAYS.fullmatch(n)} or seen
        if not beats:
            continue
        chosen = _chosen(beats, beats | pushed)
        if not within:
            slow = find_slowest(time_s, columns)
            if slow is not None and slow[1].may_cause(chosen.frequency_hz):
                return None
        # Take the channel with the smallest standard error among those that beat with the stroke frequency.
        at_it = {name: [b for b in found if multiple(b, chosen) == 1] for name, found in beats.items()}
        best = {name: min(found, key=lambda b: b.stderr_hz) for name, found in at_it.items() if found}
        channel = min(best, key=lambda name: best[name].stderr_hz)
        rivals = {}
        if stated_hz is None or abs(chosen.frequency_hz - stated_hz) > FREQUENCY_RTOL * stated_hz:
            rivals = _rivals(chosen, beats | pushed)
        return Rhythm(
            best[channel],
            channel,
            {name: found[0] for name, found in beats.items()},
            maybe_double=channel in pushed,
            rivals=rivals,
        )
    return None


def _motions(
    time_s: Array, columns: Mapping[str, Array], within: tuple[float, float] | None
) -> dict[str, list[Beat]]:
    """Return the beats of all channels that may oscillate with the stroke, by channel.

    Beats caused by laps of the path, by rotations of the heading, or by rounding are left out.
    """
    channels = {n: unwrapped(n, v) for n, v in columns.items() if not NO_MOTION.fullmatch(n)}
    channels |= swing(columns)
    seen = _beats(time_s, channels, within)
    swings = [b for n in (*ALONG, "sway") for b in seen.get(n, [])]
    lap = next((b for b in swings if _is_lap(time_s, columns, b.frequency_hz)), None)
    if lap is not None:
        track = swing(columns, 0.25 / lap.cycles)
        rest = {n: b for n, b in seen.items() if n not in (*ALONG, "sway")}
        channels = {n: v for n, v in channels.items() if n not in (*ALONG, "sway")} | track
        seen = _beats(time_s, track, within) | rest
        seen = {
            n: [b for b in beats if not 1 <= multiple(b, lap) <= MAX_LAP_HARMONIC]
            for n, beats in seen.items()
        }
    for name in seen:
        turns = _turns(channels[name]) if name.endswith("_rad") else 0.0
        if turns >= 1.0:
            near_hz = 1.0 / float(np.ptp(time_s))
            turning = Beat(turns * near_hz, 0.0, 0.0, 0.0, turns)
            beats = seen[name]
            seen[name] = [b for b in beats if not 1 <= multiple(b, turning, near_hz) <= MAX_COMPASS_HARMONIC]
        # Leave out beats that are not larger than the rounding error, because they cannot be distinguished
        # from it. A rounding error is at most half of the rounding step, and it is periodic in a steady
        # motion.
        measured = _coordinates(columns)
        if name in columns:
            measured = [columns[name]]
        rounding = sum(map(quantum, measured))
        seen[name] = [b for b in seen[name] if b.amplitude > rounding / 2 * np.sqrt(2.0 * b.share)]
    return {name: beats for name, beats in seen.items() if beats}


def _is_lap(time_s: Array, columns: Mapping[str, Array], frequency_hz: float) -> bool:
    """Return whether the path of a track makes one lap per period of a given frequency."""
    axes = _coordinates(columns)
    if len(axes) < 2:
        return False
    there = np.isfinite(axes).all(axis=0)
    x, y = (_phasors(time_s[there], values[there], frequency_hz) for values in axes)
    if len(x) != len(y):
        return False
    less, more = sorted(float(np.mean(np.abs(x + turn * y) ** 2)) for turn in (1j, -1j))
    return less < MAX_LAP_RATIO**2 * more


def _phasors(t: Array, x: Array, frequency_hz: float) -> NDArray[np.complex128]:
    """Return the complex amplitude of a sine in each window of a channel, or one in a short record."""
    windows = demodulate(t, x, frequency_hz)
    if windows is not None:
        return windows[1]
    design = np.column_stack((np.vander(t - t.mean(), 3), waves(t, frequency_hz)))
    weights = np.linalg.lstsq(design, x, rcond=None)[0]
    return np.array([weights[3] - 1j * weights[4]])


def _turns(angle: Array) -> float:
    """Return the number of full rotations of an unwrapped angle from its first to its last sample."""
    known = angle[np.isfinite(angle)]
    return abs(float(known[-1] - known[0])) / (2 * np.pi) if len(known) else 0.0


def find_slowest(time_s: Array, columns: Mapping[str, Array]) -> tuple[str, Beat] | None:
    """Find an oscillation with too few cycles for a frequency; return the name of its channel, and its beat.

    If the drive is logged, only the channels of the drive are searched. Otherwise the track and all channels
    that oscillate sideways are searched. Of several slow oscillations, the one with the highest frequency is
    returned.
    """
    driven = [n for n in columns if DRIVEN.fullmatch(n)]
    names = driven or [n for n in columns if SIDEWAYS.fullmatch(n)]
    signals = {name: unwrapped(name, columns[name]) for name in names}
    axes = _coordinates(columns)
    if axes and not driven:
        place = np.column_stack(axes)
        there = np.isfinite(place).all(axis=1)
        if there.sum() > 2:
            line = np.polynomial.polynomial.polyfit(time_s[there], place[there], 1)
            about = place - np.polynomial.polynomial.polyval(time_s, line).T
            axis = np.linalg.svd(about[there], full_matrices=False)[2][0]
            signals["the track"] = about @ axis
    found = {name: _slow_motion(time_s, values) for name, values in signals.items()}
    slow = {name: motion for name, motion in found.items() if motion is not None}
    return max(slow.items(), key=lambda item: item[1].frequency_hz, default=None)


def _chosen(candidates: Mapping[str, list[Beat]], seen: Mapping[str, list[Beat]]) -> Beat:
    """Return the candidate beat that is taken for the stroke, by the rules given in :func:`find_stroke`."""

    def worth(beat: Beat) -> tuple[bool, bool, int, bool, float, float]:
        # Compute from the amplitudes the fraction of each channel's variance at once or twice the frequency
        # of the beat.
        at_it = {}
        for name, beats in seen.items():
            whole = sum(b.amplitude**2 for b in beats) / beats[0].share
            largest = max((b.amplitude for b in beats if multiple(b, beat) in (1, 2)), default=0.0)
            at_it[name] = largest**2 / whole
        names = [name for name, share in at_it.items() if share > 0]
        motions = sum(any(motion.fullmatch(name) for name in names) for motion in MOTIONS)
        return (
            beat.frequency_hz <= MAX_STROKE_HZ,
            any(DRIVEN.fullmatch(name) for name in names),
            motions,
            any(MOVED.fullmatch(name) for name in names),
            round(sum(at_it.values()), 3),
            -beat.frequency_hz,
        )

    return max((beat for beats in candidates.values() for beat in beats), key=worth)


def _rivals(chosen: Beat, seen: Mapping[str, list[Beat]]) -> dict[str, Beat]:
    """Return the largest beat of each channel whose frequency contradicts that of the stroke.

    Beats at a multiple of the stroke frequency do not contradict it, nor do faster beats with little power
    relative to the stroke.
    """
    found = {}
    for name, beats in seen.items():
        stroke = max((b.amplitude for b in beats if multiple(b, chosen)), default=0.0)
        others = [b for b in beats if not multiple(b, chosen)]
        ripple, slow = MIN_SHARE * stroke**2, chosen.frequency_hz
        against = [b for b in others if b.amplitude**2 >= ripple or b.frequency_hz < slow]
        if against:
            found[name] = max(against, key=lambda beat: beat.amplitude)
    return found


def add_time_error(stroke: Rhythm, time_sd_s: float, time_s: Array) -> Rhythm:
    """Return a copy of the stroke whose standard error includes errors of the first and last time stamps."""
    error = stroke.beat.frequency_hz * np.sqrt(2.0) * time_sd_s / float(np.ptp(time_s))
    beat = replace(stroke.beat, stderr_hz=float(np.hypot(stroke.beat.stderr_hz, error)))
    return replace(stroke, beat=beat)


def explain_missing(time_s: Array, columns: Mapping[str, Array]) -> tuple[str, float | None]:
    """Return the reason why a log has no stroke, and the frequency of a slow motion, Hz, or None."""
    duration = float(np.ptp(time_s)) if len(time_s) else 0.0
    slow = find_slowest(time_s, columns)
    slow_hz, laps, axes = None, [], _coordinates(columns)
    if slow is not None:
        slow_hz = slow[1].frequency_hz
        laps = [slow_hz]
    elif len(axes) > 1:
        laps = [beat.frequency_hz for v in axes for beat in find_beats(*_prepared(time_s, v))]
    for frequency_hz in laps:
        if _is_lap(time_s, columns, frequency_hz):
            text = f"the path goes in circles of {1.0 / frequency_hz:.3g} s; nothing else keeps a beat"
            return text, slow_hz
    if slow is not None:
        name, motion = slow
        text = f"the strongest motion of {name}, at about {motion.frequency_hz:.2g} Hz, has only "
        cycles = f"{motion.cycles:.1f} cycles in {duration:.3g} s; a stroke needs {MIN_CYCLES:g}"
        return text + cycles, slow_hz
    lowest = f"in {duration:.3g} s: from {MIN_CYCLES / max(duration, 1e-300):.3g} Hz on"
    return f"nothing in it keeps a beat over {MIN_CYCLES:g} cycles or more ({lowest})", None


def _beats(
    time_s: Array, columns: Mapping[str, Array], within: tuple[float, float] | None
) -> dict[str, list[Beat]]:
    """Return the beats of each channel by its name, without the channels that have no beat."""
    low, high = within or (None, None)
    found = {}
    for name, values in columns.items():
        beats = find_beats(*_prepared(time_s, values), lowest_hz=low, highest_hz=high)
        if beats:
            found[name] = beats
    return found


def _prepared(time_s: Array, values: Array) -> tuple[Array, Array]:
    """Return the samples of a channel for the search for a beat, reduced to :data:`MAX_RATE_HZ` or less.

    The result holds times and samples. The samples are those of the longest segment without gaps, at even
    time steps. If that segment is too short, all samples are returned.
    """
    time, even = longest_even(time_s, values, MAX_RATE_HZ)
    there = np.isfinite(values)
    if (
        len(time) < MIN_STRETCH_SHARE * there.sum() <= MAX_SAMPLES
        and np.median(np.diff(time_s[there])) * MAX_RATE_HZ >= 1.0
    ):
        time, even = time_s[there], values[there]
    known = np.isfinite(even)
    if known.sum() < 16 or np.ptp(even[known]) == 0:
        return np.empty(0), np.empty(0)
    return time, even


# ---------------------------------------------------------------- course and heading

#: Minimum number of pairs of successive time windows in which the course is compared with the heading.
MIN_COURSE_WINDOWS = 8
#: Minimum fraction of a window from its first to its last sample. Its mean is then free of a sway with the
#: period of the window, up to a tenth of the amplitude.
MIN_KNOWN_SPAN = 0.9
#: Natural logarithm of the smallest Bayes factor that counts as "very strong" evidence (Kass and Raftery
#: 1995, JASA 90).
VERY_STRONG = math.log(150.0)
#: Maximum angle between direction of travel and heading, rad: the drift angle of a hull in its tightest turn
#: (Fossen 2011, *Handbook of Marine Craft Hydrodynamics*, 7.1: 10 to 20 degrees for ships). A larger angle is
#: taken for an error of the columns.
LARGEST_SLIP = math.radians(30.0)
#: Minimum mean angle between heading and course, rad, that is reported. It is half of the angle that swapped
#: axes cause.
MIN_ANGLE = math.radians(45.0)


@dataclass(frozen=True)
class Course:
    """Difference between the direction of travel (course) and the heading, over windows of tracks.

    Attributes
    ----------
    slip_rad : float
        Mean of course minus heading, rad, -pi to pi.
    spread_rad : float
        Circular standard deviation of course minus heading, rad.
    mirrored : bool
        Whether the course follows the negative of the heading, as in a mirrored image.
    opposed : bool
        Whether the course seems to follow the negative of the heading, but the difference is small. It is
        less than a hull may slip in a turn, and more than the heading swings in a window.
    """

    slip_rad: float
    spread_rad: float
    mirrored: bool
    opposed: bool

    def turned(self, name: str) -> str:
        """Return a message if the heading, column ``name``, stands at a constant angle to the course."""
        if self.spread_rad >= LARGEST_SLIP or abs(self.slip_rad) <= MIN_ANGLE:
            return ""
        angle = abs(math.degrees(self.slip_rad))
        text = f"stands at {angle:.0f} degrees to the course of the track on average"
        hint = f"unless the robot swims that way by intent, write offset: {self.slip_rad:.4f} for {name}"
        return f"{text}: {hint}; a compass heading needs factor: -1 and offset: 1.5708"


def compare_course(tracks: Iterable[tuple[Array, Array, Array, Array]], window_s: float) -> Course | None:
    """Compare the direction of travel (course) with the heading, in tracks seen by one camera.

    Parameters
    ----------
    tracks : iterable of (t, x, y, heading)
        Each shape (n,), in s, m, m and rad; NaN where missing.
    window_s : float
        Length of a window, s: at least one stroke, so that the oscillation of the body averages out.

    Returns
    -------
    Course or None
        None if fewer than :data:`MIN_COURSE_WINDOWS` pairs of successive windows have more advance than sway.
    """
    pairs = [pair for track in tracks for pair in _windows(*track, window_s)]
    if len(pairs) < MIN_COURSE_WINDOWS:
        return None
    course, heading = np.array(pairs).T
    swing = math.sqrt(-2.0 * math.log(min(float(np.mean(np.abs(heading))), 1.0)))
    heading = heading / np.abs(heading)
    along, against = np.mean(course * heading.conj()), np.mean(course * heading)
    spread = math.sqrt(-2.0 * math.log(min(max(abs(along), 1e-12), 1.0)))
    evidence = _likelihood(abs(against), len(pairs)) - _likelihood(abs(along), len(pairs))
    mirrored = evidence > VERY_STRONG and spread > LARGEST_SLIP
    opposed = evidence > VERY_STRONG and swing < spread <= LARGEST_SLIP
    return Course(float(np.angle(along)), spread, bool(mirrored), bool(opposed))


def is_in_degrees(tracks: Iterable[tuple[Array, Array, Array, Array]], window_s: float) -> bool:
    """Return whether the headings of tracks are in degrees: only then do they agree with the course.

    If all tracks have the same course, the unit of the headings cannot be determined, and the result is
    False.

    Parameters
    ----------
    tracks, window_s
        The arguments of :func:`compare_course`.
    """
    tracks = list(tracks)
    turned = [(t, x, y, np.radians(heading)) for t, x, y, heading in tracks]
    plain, found = compare_course(tracks, window_s), compare_course(turned, window_s)
    # The function compares the course with the heading. With a heading of zero it returns the circular
    # standard deviation of the course.
    still = compare_course([(t, x, y, np.zeros_like(heading)) for t, x, y, heading in tracks], window_s)
    if found is None or still is None or (plain is not None and plain.spread_rad < LARGEST_SLIP):
        return False
    follows = found.spread_rad < LARGEST_SLIP and abs(found.slip_rad) < LARGEST_SLIP
    return follows and still.spread_rad > LARGEST_SLIP


def _windows(
    time: Array, x: Array, y: Array, heading: Array, window_s: float
) -> list[tuple[complex, complex]]:
    """Return course and mean heading as complex numbers, for each two successive windows.

    The course is the direction from the mean place of a window to that of the next one. A mean over whole
    strokes is free of the sway, which a line fitted to a single stroke is not. Windows with gaps at their
    ends are left out, and courses with less advance than sway. The course has the absolute value 1, the
    heading that of the mean of its unit vectors.
    """
    there = np.isfinite(x) & np.isfinite(y) & np.isfinite(heading)
    if there.sum() < 3:
        return []
    time, path, facing = time[there], (x + 1j * y)[there], np.exp(1j * heading[there])
    window_s, step = min(window_s, np.ptp(time) / 2), float(np.median(np.abs(np.diff(time))))
    numbers = ((time - time[0]) // window_s).astype(int)
    order = np.argsort(numbers, kind="stable")
    means: dict[int, tuple[complex, complex, float]] = {}
    for window in np.split(order, np.flatnonzero(np.diff(numbers[order])) + 1):
        if np.ptp(time[window]) + step > MIN_KNOWN_SPAN * window_s:
            place, ahead = complex(np.mean(path[window])), complex(np.mean(facing[window]))
            means[int(numbers[window[0]])] = place, ahead, float(np.std(path[window]))
    pairs = []
    for number in sorted(means.keys() & {n - 1 for n in means}):
        (place, ahead, sway), (later, turned, sway_later) = means[number], means[number + 1]
        advance, mean_ahead = later - place, (ahead + turned) / 2
        if abs(advance) > max(sway, sway_later) and abs(mean_ahead) > 0.5:
            pairs.append((advance / abs(advance), mean_ahead))
    return pairs


def _likelihood(length: float, count: int) -> float:
    """Return the maximum log-likelihood of ``count`` angles under a von Mises distribution.

    ``length`` is the mean resultant length of the angles.
    """
    from scipy.optimize import brentq
    from scipy.special import i0e, i1e

    length = min(length, 1.0 - 1e-6)
    kappa = brentq(lambda kappa: i1e(kappa) / i0e(kappa) - length, 0.0, 1e6)
    return count * (kappa * length - kappa - math.log(i0e(kappa)))
