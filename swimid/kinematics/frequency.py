"""Frequency of the stroke in one channel, with its error."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.logs.log import FREQUENCY_RTOL
from swimid.logs.sampling import has_levels, usual_step
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
#: Test for a spectral line (Thomson's F test): time-bandwidth product (BAND), number of tapers (N_TAPERS),
#: and maximum number of cycles of a tested record (MAX_LINE_CYCLES). In longer records the beat frequency
#: varies, and the comparison of phases between windows is powerful enough.
BAND, N_TAPERS, MAX_LINE_CYCLES = 3.0, 5, 30.0
#: Fraction of a record at its start, and at its end, that is tapered to zero before the spectrum is computed.
TAPERED_SHARE = 0.1
#: Minimum fraction of samples of a record that are not missing, for the test for a spectral line.
MIN_KNOWN_SHARE = 0.8
#: Probability of a false detection of a beat in noise of any spectrum.
FALSE_ALARM_BEAT = 0.01
#: Minimum fractions of a channel's variance about its drift that beats must explain. At least one beat of a
#: channel must reach MIN_SHARE. Every beat must reach MIN_FAINT_SHARE, which is smaller because a stroke may
#: be weaker than its own harmonic.
MIN_SHARE, MIN_FAINT_SHARE = 0.1, 0.02
#: Rest of a robot before or after a swim: maximum change of a channel, divided by its largest usual change
#: (REST_SHARE). The part between the rests is searched alone if it is at most the fraction MAX_ACTIVE_SHARE
#: of the record.
REST_SHARE, MAX_ACTIVE_SHARE = 0.5, 0.9
#: Minimum fraction of a channel's variance about its drift that its strongest line must explain. Only then do
#: frequencies of less power not count in the correction for the number of frequencies.
MIN_MAIN_SHARE = 0.8
#: Relative tolerance within which two frequencies count as equal, or one as a multiple of the other.
SAME_RTOL = 0.03
#: Maximum number of windows of a record in the linear regression of the phase over time. The windows are
#: spread over the record.
MAX_WINDOWS = 120
#: Minimum number of samples in a window of two cycles to which a sine is fitted.
MIN_SAMPLES_BEAT = DRIFT_ORDER + 5
#: Ridge that is added to the covariance of a beat's phases in successive windows to make it regular. The
#: phase of a window is ignored if its amplitude, divided by the largest amplitude, is below the square root
#: of this ridge.
RIDGE = 1e-9
#: Maximum order of a harmonic that a stronger and slower motion may cause. A beat at a higher multiple is not
#: taken for a harmonic of that motion.
MAX_HARMONIC = 5
#: Maximum frequency of the search for a beat, divided by a stated stroke frequency.
MAX_STATED_RATIO = 8.0
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


def read_frequency(metadata: Mapping[str, Any]) -> float | None:
    """Return the stroke frequency that the metadata of a log state, Hz; None without a positive number."""
    value = metadata.get("frequency_hz")
    if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
        return None
    return value


def compare_frequencies(
    trial: str, stated_hz: float, time_s: Array, heading: Array, consequence: str
) -> dict[str, float | None]:
    """Return the stated and the estimated stroke frequency of a trial, Hz, and warn of a contradiction.

    The keys are ``stated_hz``, ``found_hz`` and ``stderr_hz``. Without a beat the last two values are None.

    Parameters
    ----------
    time_s, heading : ndarray, shape (n,)
        Times, s, and unwrapped heading, rad, in which the beat is searched up to :data:`MAX_STATED_RATIO`
        times the stated frequency. NaN is allowed.
    consequence : str
        Clause of the warning that says which of the two frequencies the caller uses.
    """
    highest = min(MAX_STATED_RATIO * stated_hz, 0.45 / usual_step(time_s[np.isfinite(heading)]))
    beat = find_beat(time_s, heading, highest_hz=highest)
    if beat is None:
        return {"stated_hz": stated_hz, "found_hz": None, "stderr_hz": None}
    if against := contradiction(beat, stated_hz):
        text = f"the heading {against}, but the trials file says {stated_hz:g} Hz; {consequence}"
        warn("SWM032", f"{trial}: {text}")
    return {"stated_hz": stated_hz, "found_hz": beat.frequency_hz, "stderr_hz": beat.stderr_hz}


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
    if len(t) < 2 * MIN_SAMPLES_BEAT:
        return []
    first, end = _active_part(x)
    if end - first < MAX_ACTIVE_SHARE * len(x):
        beats = find_beats(t[first:end], x[first:end], lowest_hz=lowest_hz, highest_hz=highest_hz)
        if beats:
            return beats
    tested, sure = _test_peaks(t, x, lowest_hz, highest_hz)
    if not sure:
        return []
    if has_levels(x):
        # Remove beats that are harmonics of jumps between levels. A signal with jumps has harmonics of any
        # order, but at most half as many cycles as jumps.
        jumps = np.count_nonzero(np.diff(x))
        sure = [beat for beat in sure if 2.0 * beat.cycles <= jumps + 1.0]
    if lowest_hz is None and (slow := find_slow_motion(t, x)) is not None:
        # Keep a beat that may be a harmonic only if it moves faster than the slow motion.
        rate = slow.amplitude * slow.frequency_hz
        sure = [b for b in sure if not slow.may_cause(b.frequency_hz) or b.amplitude * b.frequency_hz > rate]
    return _remove_harmonics(tested, sure, 1.0 / (t[-1] - t[0]))


def _test_peaks(
    t: Array, x: Array, lowest_hz: float | None, highest_hz: float | None
) -> tuple[list[Beat], list[Beat]]:
    """Return all beats at the spectral peaks of a channel, and those that are significant in the search."""
    duration, step = t[-1] - t[0], usual_step(t)
    low = max(lowest_hz or 0.0, MIN_CYCLES / duration)
    # Limit the range of the search: an unevenly sampled record determines no more frequencies than an evenly
    # sampled record of as many samples.
    high = min(highest_hz or 0.45 / step, low + 2 * len(t) / duration)
    if high <= low or np.ptp(x) <= 1e-12 * np.max(np.abs(x)):
        return [], []
    peaks, main, number = _peaks(t, x, low, high, duration)
    tested = [result for frequency in peaks if (result := _test(t, x, frequency, duration)) is not None]
    limit = FALSE_ALARM_BEAT / max(duration * (high - low), 1.0)
    sure = [beat for chance, beat in tested if chance < limit]
    # If the strongest line holds most of the power, it competes with few other frequencies.
    sure += [
        beat
        for chance, beat in tested
        if limit <= chance < FALSE_ALARM_BEAT / number
        and abs(beat.frequency_hz - main) < 1.0 / duration
        and beat.share > MIN_MAIN_SHARE
        and beat.cycles > 1.5 * MIN_CYCLES
    ]
    return [beat for _, beat in tested], sure


def _remove_harmonics(tested: list[Beat], sure: list[Beat], resolution_hz: float) -> list[Beat]:
    """Return the fundamental of the largest significant beat, and the beats that are not its multiples."""
    large = [beat for beat in sure if beat.share >= MIN_SHARE]
    if not large:
        return []
    largest = max(large, key=lambda beat: beat.amplitude)
    # The largest beat may be the second or third harmonic of the stroke. Therefore a detected beat at one
    # half or one third of its frequency has precedence.
    below = [
        beat
        for beat in tested
        if any(abs(k * beat.frequency_hz - largest.frequency_hz) < resolution_hz for k in (2, 3))
    ]
    first = max(below, key=lambda beat: beat.amplitude, default=largest)
    # Leave out multiples of the first beat, and beats near its frequency, from which windows of two cycles
    # cannot separate them.
    others = [
        beat
        for beat in sure
        if abs(beat.frequency_hz - first.frequency_hz) > beat.frequency_hz / WINDOW_CYCLES
        and not multiple(beat, first, resolution_hz)
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


def find_slow_motion(time_s: Array, values: Array) -> Beat | None:
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
    if len(t) < 2 * MIN_SAMPLES_BEAT or not np.ptp(x) > 1e-12 * np.max(np.abs(x)):
        return None
    duration = float(t[-1] - t[0])
    t = t - t[0]
    u = 2.0 * t / duration - 1.0

    def fit(design: Array) -> tuple[float, NDArray[np.floating[Any]]]:
        weights = np.linalg.lstsq(design, x, rcond=None)[0]
        return float(np.sum((x - design @ weights) ** 2)), weights

    tried = np.arange(1.0, 1.5 * MIN_CYCLES, 0.1)
    fits = [fit(np.column_stack((waves(t, n / duration), np.vander(u, 3)))) for n in tried]
    best = int(np.argmin([squares for squares, _ in fits]))
    squares, weights = fits[best]
    cycles, drift_squares = float(tried[best]), fit(np.vander(u, 6))[0]
    if best == 0 or cycles >= MIN_CYCLES or squares >= PERIODIC_SHARE * drift_squares:
        return None
    return Beat(cycles / duration, np.nan, float(np.hypot(*weights[:2])), np.nan, cycles)


def waves(t: Array, frequency_hz: float, harmonics: Iterable[int] = (1,)) -> Array:
    """Return cosine and sine of each of k harmonics of a frequency, shape (n, 2 k), at n times in s."""
    turn = 2 * np.pi * frequency_hz * t
    return np.column_stack([wave(k * turn) for k in harmonics for wave in (np.cos, np.sin)])


def multiple(beat: Beat, of: Beat, resolution_hz: float = 0.0) -> int:
    """Return the ratio of two beat frequencies if it is a whole number; 0 if it is not.

    The ratio need be a whole number only within the errors of the frequencies. This tolerance is at least
    ``resolution_hz``, Hz.
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
    """Test for a beat at a frequency, and return the p-value of the test and the beat.

    The p-value is the probability that noise passes the test. The result is None if the channel has no beat
    at this frequency.
    """
    windows = demodulate(t, x, frequency)
    if windows is None:
        return None
    time, amplitude, share, width, hop = windows
    chance = 3.0 * min(*_incoherent(time, amplitude, width, hop), _no_line(t, x, frequency))
    if chance >= FALSE_ALARM_BEAT or share < MIN_FAINT_SHARE:
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
            Middle of each of the m windows, s, and complex amplitude in the unit of the channel. Windows with
            a negligible amplitude have no phase and are left out.
    share : float
        Fraction of the variance about the polynomial that the sine explains.
    width, hop : float
            Duration of a window, and time between successive windows, s. The function returns None if fewer
            than three windows are left.
    """
    # At a low sample rate the windows must be longer than two cycles, so that they hold enough samples.
    step = float(np.median(np.diff(t)))
    hop = max(1.0, np.ceil(MIN_SAMPLES_BEAT * step * frequency / WINDOW_CYCLES)) / frequency
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
    enough = ends[:, 1] - ends[:, 0] >= max(MIN_SAMPLES_BEAT, 0.5 * width / step)
    if enough.sum() < 3:
        return None
    time = starts[enough] + 0.5 * width
    amplitude, share = _fit_windows(t, x, ends[enough], time, width, frequency)
    carries = np.abs(amplitude) > np.sqrt(RIDGE) * np.max(np.abs(amplitude))
    if carries.sum() < 3:
        return None
    return time[carries], amplitude[carries], share, width, hop


def _incoherent(time: Array, amplitude: Complex, width: float, hop: float) -> tuple[float, float]:
    """Return the probabilities that noise has at least the observed coherence of amplitudes between windows.

    The first probability is for a constant frequency: successive windows have equal phases. The second is for
    a wandering frequency: the phase of each window is the mean of those before and after it.
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

    The tapers are discrete prolate spheroidal sequences, shape (N_TAPERS, count). Do not change the array:
    the last result is cached, because the channels of a log have the same count.
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


def _fit_windows(
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
