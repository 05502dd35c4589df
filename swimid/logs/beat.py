"""The beat frequency of a swimming log, with its uncertainty."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swimid.logs.log import FREQUENCY_RTOL
from swimid.logs.sampling import has_levels
from swimid.notices import warn

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Cycles of the short windows a beat is fitted in; they overlap by all but one cycle.
WINDOW = 2
#: Order of the polynomial fitted with it in each window: drift and turns are slower than two cycles.
DRIFT = 3
#: Fewest cycles from which a frequency is told: with fewer a line cannot be told from the noise about it.
FEWEST_CYCLES = 4.0
#: Time-bandwidth product and number of the tapers of the line test, and the most cycles it is made for: in
#: longer records a rhythm wanders, and windows have power enough.
BAND, TAPERS, LINE_CYCLES = 3.0, 5, 30.0
#: Share of a record at either end that is tapered for its spectrum.
TAPERED = 0.1
#: Share of a record that must be known for it.
KNOWN = 0.8
#: Chance that noise of any colour, without a beat, is said to beat.
FALSE_ALARM = 0.01
#: A beat explains at least this share of what moves faster than the drift; beside a harmonic larger than
#: itself at least the lower one.
MIN_SHARE, FAINTEST = 0.1, 0.02
#: Frequencies that agree within this share of the lower one are one, or one a multiple of the other.
TOGETHER = 0.03
#: Windows whose phases are regressed; of more, only so many are spread over the record.
MOST_WINDOWS = 120
#: Fewest samples a window needs.
SAMPLES = DRIFT + 5
#: Ridge that keeps the covariance of phases regular. The phase of a window whose amplitude is below its
#: square root, relative to the largest, would drown in it: such a window carries no phase.
RIDGE = 1e-9
#: A beat up to this many times as fast as a stronger, slower motion may be a harmonic of it.
HARMONICS = 5
#: A slow motion is periodic where a sine leaves less than this share of what a polynomial of as many
#: coefficients leaves. The polynomial describes a drift or a turn.
PERIODIC = 0.5


@dataclass(frozen=True)
class Beat:
    """A periodic component.

    Attributes
    ----------
    frequency_hz, stderr_hz : float
    amplitude : float
        Of the fundamental, in the channel's unit.
    share : float
        Part of the variance about the drift that the fundamental explains.
    cycles : float
        How many the record holds. Below :data:`FEWEST_CYCLES` the frequency is approximate, and its standard
        error and share are not known (NaN).
    """

    frequency_hz: float
    stderr_hz: float
    amplitude: float
    share: float
    cycles: float = np.inf

    @property
    def interval_hz(self) -> tuple[float, float]:
        """95 % interval (Student's t over the cycles), Hz."""
        from scipy import special

        half = float(special.stdtrit(max(self.cycles - WINDOW - 1.0, 1.0), 0.975)) * self.stderr_hz
        return self.frequency_hz - half, self.frequency_hz + half

    def may_cause(self, frequency_hz: float) -> bool:
        """Return whether a beat at this frequency may be a harmonic of this motion."""
        return frequency_hz < (HARMONICS + 0.5) * self.frequency_hz


def contradiction(found: Beat, stated_hz: float) -> str | None:
    """In words, how a beat contradicts a stated frequency; None where it does not.

    >>> contradiction(Beat(2.0, 0.01, 1.0, 0.9), 1.0)
    'beats at 2.000 ± 0.010 Hz, 2.00 times as fast'
    """
    if abs(found.frequency_hz - stated_hz) <= max(FREQUENCY_RTOL * stated_hz, 3 * found.stderr_hz):
        return None
    ratio = found.frequency_hz / stated_hz
    whole = f", {ratio:.2f} times as fast" if abs(ratio - round(ratio)) < 0.05 and ratio > 1.5 else ""
    return f"beats at {found.frequency_hz:.3f} ± {found.stderr_hz:.3f} Hz{whole}"


def stated_against_found(
    trial: str, stated_hz: float, beat: Beat | None, *, used: str
) -> dict[str, float | str | None]:
    """Stated and found frequency of a trial, Hz; warns where they contradict each other.

    Parameters
    ----------
    beat : Beat or None
        As found in the heading.
    used : {"measured", "stated"}
        Which of the two the work goes on with, for the warning.
    """
    if beat is None:
        return {"stated_hz": stated_hz, "found_hz": None, "stderr_hz": None}
    against = contradiction(beat, stated_hz)
    if against is not None:
        last = (
            "correct it if it is wrong: it is used" if used == "stated" else "the measured frequency is used"
        )
        warn("SWM032", f"{trial}: the heading {against}, the trials file says {stated_hz:g} Hz; {last}")
    return {"stated_hz": stated_hz, "found_hz": beat.frequency_hz, "stderr_hz": beat.stderr_hz}


def find_beat(
    time_s: Array, values: Array, *, lowest_hz: float | None = None, highest_hz: float | None = None
) -> Beat | None:
    """The strongest periodic component of a channel, or None where there is none: the first of all it has."""
    return next(iter(find_beats(time_s, values, lowest_hz=lowest_hz, highest_hz=highest_hz)), None)


def find_beats(
    time_s: Array, values: Array, *, lowest_hz: float | None = None, highest_hz: float | None = None
) -> list[Beat]:
    """The periodic components of a channel that are no multiples of each other, the strongest first.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Uneven steps and NaN are allowed.
    lowest_hz, highest_hz : float, optional
        Range searched; default :data:`FEWEST_CYCLES` in the record to half the sample rate. Fewer cycles
        than that tell no frequency, whatever is asked for.

    Returns
    -------
    list of Beat
        Empty where the record is too short, nothing in it keeps its phase from window to window, or the beats
        may be harmonics of a stronger motion of fewer than :data:`FEWEST_CYCLES` cycles. Those after the
        first explain at least :data:`FAINTEST` of what moves faster than the drift.

    Notes
    -----
    Candidates are the peaks of the Lomb-Scargle spectrum and of that of the derivative. Each is fitted as a
    sine beside a cubic in windows of two cycles, so that drift and turns drop out, and harmonics are
    orthogonal to it. A beat keeps its phase: the coherence of amplitudes two windows apart has a known
    distribution for noise of any colour (Goodman 1963: its square is Beta(1, m - 1) over m independent
    pairs), and must exceed its quantile for all frequencies searched. In a record of few cycles Thomson's F
    test (1982) tells a line from the noise about it, too. The frequency is the slope of the windows' phases
    over time, by generalised least squares; the phases scatter by noise and wander like a random walk, in a
    proportion that restricted likelihood tells, so that the standard error is that of a clock for a clock,
    and that of a wandering rhythm for one.
    """
    there = np.isfinite(values) & np.isfinite(time_s)
    t, x = time_s[there], values[there]
    if len(t) < 2 * SAMPLES:
        return []
    duration, step = t[-1] - t[0], float(np.median(np.diff(t)))
    low = max(lowest_hz or 0.0, FEWEST_CYCLES / duration)
    # no more frequencies than an even record of as many samples has, however uneven this one is
    high = min(highest_hz or 0.45 / step, low + 2 * len(t) / duration)
    if high <= low or np.ptp(x) <= 1e-12 * np.max(np.abs(x)):
        return []
    examined = (_examined(t, x, frequency, duration) for frequency in _peaks(t, x, low, high, duration))
    found = [beat for beat in examined if beat is not None]
    limit = FALSE_ALARM / max(duration * (high - low), 1.0)
    sure = [beat for chance, beat in found if chance < limit]
    slow = find_slow_motion(t, x) if lowest_hz is None else None
    if has_levels(x):
        # a signal that jumps has harmonics of any order, but no more cycles than half of its jumps
        jumps = np.count_nonzero(np.diff(x))
        sure = [beat for beat in sure if 2.0 * beat.cycles <= jumps + 1.0]
    if slow is not None:
        fastest, harmonics = slow.amplitude * slow.frequency_hz, slow.may_cause
        sure = [b for b in sure if b.amplitude * b.frequency_hz > fastest or not harmonics(b.frequency_hz)]
    large = [beat for beat in sure if beat.share >= MIN_SHARE]
    if not large:
        return []
    largest = max(large, key=lambda beat: beat.amplitude)
    # a harmonic may be larger than the stroke itself, which then is there as well
    below = [
        beat
        for _, beat in found
        if any(abs(k * beat.frequency_hz - largest.frequency_hz) < 1.0 / duration for k in (2, 3))
    ]
    first = max(below, key=lambda beat: beat.amplitude, default=largest)
    # windows of two cycles of a beat that lies near the first see that as well
    others = [
        beat
        for beat in sure
        if abs(beat.frequency_hz - first.frequency_hz) > beat.frequency_hz / WINDOW
        and not multiple(beat, first, 1.0 / duration)
    ]
    return [first, *sorted(others, key=lambda beat: -beat.amplitude)]


def find_slow_motion(time_s: Array, values: Array) -> Beat | None:
    """Return the strongest motion of a channel if it is periodic and has too few cycles for a beat.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Uneven steps and NaN are allowed.

    Notes
    -----
    A sine beside a parabola is fitted at every frequency up to one and a half times the limit. Its residual
    is compared with that of a quintic, which has as many coefficients.
    """
    there = np.flatnonzero(np.isfinite(values) & np.isfinite(time_s))
    there = there[:: max(len(there) // 1000, 1)]
    t, x = time_s[there], values[there]
    if len(t) < 2 * SAMPLES or not np.ptp(x) > 1e-12 * np.max(np.abs(x)):
        return None
    duration = float(t[-1] - t[0])
    u = 2.0 * (t - t[0]) / duration - 1.0
    powers = np.polynomial.legendre.legvander(u, 5)
    parabola, quintic = (np.linalg.qr(powers[:, :k])[0] for k in (3, 6))
    x = x - parabola @ (parabola.T @ x)
    cycles = np.arange(1.0, 1.5 * FEWEST_CYCLES, 0.1)
    turns = np.exp(2j * np.pi * cycles[:, None] * (t - t[0]) / duration)
    sines = np.stack([turns.real, turns.imag], axis=-1)
    sines -= parabola @ (parabola.T @ sines)
    normal = sines.transpose(0, 2, 1) @ sines
    right = sines.transpose(0, 2, 1) @ x
    weights = np.linalg.solve(normal, right[..., None])[..., 0]
    explained = np.sum(right * weights, axis=1)
    best = int(np.argmax(explained))
    drift = float(np.sum((x - quintic @ (quintic.T @ x)) ** 2))
    periodic = float(x @ x) - explained[best] < PERIODIC * drift
    if best == 0 or cycles[best] >= FEWEST_CYCLES or not periodic:
        return None
    amplitude = float(np.hypot(*weights[best]))
    return Beat(cycles[best] / duration, np.nan, amplitude, np.nan, float(cycles[best]))


def waves(t: Array, frequency_hz: float, harmonics: Iterable[int] = (1,)) -> Array:
    """Return cosine and sine of each harmonic of a frequency, shape (n, 2 k), at times in s, shape (n,)."""
    turn = 2 * np.pi * frequency_hz * t
    return np.column_stack([wave(k * turn) for k in harmonics for wave in (np.cos, np.sin)])


def multiple(beat: Beat, of: Beat, resolution_hz: float = 0.0) -> int:
    """Which harmonic one beat is of another, as far as their errors tell; 0 where it is none."""
    order = round(beat.frequency_hz / of.frequency_hz)
    error = 3.0 * float(np.hypot(beat.stderr_hz, order * of.stderr_hz))
    off = abs(beat.frequency_hz - order * of.frequency_hz)
    return order if off <= max(TOGETHER * of.frequency_hz, error, resolution_hz) else 0


def _peaks(t: Array, x: Array, low: float, high: float, duration: float) -> list[float]:
    """Frequencies of the highest peaks of the spectrum, and of the derivatives', where drift is small."""
    # from below, so that the flank of something slower is no peak
    grid = np.arange(max(low - 3.0 / duration, 1.0 / duration), high, 0.1 / duration)
    if len(grid) < 4:
        return []
    centred = t - t.mean()
    level = x - np.polyval(np.polyfit(centred / duration, x, 3), centred / duration)
    from_end = np.minimum(np.arange(len(x)), np.arange(len(x))[::-1]) / (len(x) - 1)
    tapered = level * (0.5 - 0.5 * np.cos(np.pi * np.minimum(from_end / TAPERED, 1.0)))
    power = _power(t, tapered - tapered.mean(), grid)
    chosen: list[float] = []
    for spectrum in (power * grid**4, power * grid**2, power):
        rises = np.diff(spectrum) > 0
        tops = [k for k in np.flatnonzero(rises[:-1] & ~rises[1:]) + 1 if grid[k] >= low]
        ranked = sorted(tops, key=lambda k: -spectrum[k])[:6]
        chosen += [float(grid[k]) for k in ranked if all(abs(grid[k] - f) > 0.5 / duration for f in chosen)]
    return chosen


def _examined(t: Array, x: Array, frequency: float, duration: float) -> tuple[float, Beat] | None:
    """Return the beat at a frequency, and the probability that noise makes its windows as coherent.

    The result is None where there is no beat.
    """
    windows = demodulate(t, x, frequency)
    if windows is None:
        return None
    time, amplitude, share, width, hop = windows
    chance = min(2.0 * _incoherent(time, amplitude, width, hop), 2.0 * _no_line(t, x, frequency), 1.0)
    if chance >= FALSE_ALARM or share < FAINTEST:
        return None
    size = np.abs(amplitude)
    slope, stderr = _slope(time, np.unwrap(np.angle(amplitude)), size)
    found = frequency + slope / (2 * np.pi)
    beat = Beat(found, stderr / (2 * np.pi), float(np.mean(size)), share, found * duration)
    # Phases that turn round over the record are those of another frequency, leaking; and a frequency is
    # known where the number of cycles in the record is, to one.
    resolved = beat.interval_hz[1] - found < 1.0 / duration
    return (chance, beat) if resolved and abs(found - frequency) < 1.0 / duration else None


def demodulate(t: Array, x: Array, frequency: float) -> tuple[Array, Complex, float, float, float] | None:
    """Fit a sine of given frequency beside a polynomial in windows of two cycles.

    Parameters
    ----------
    t, x : ndarray, shape (n,)
        Without NaN.
    frequency : float
        Hz.

    Returns
    -------
    time, amplitude : ndarray, shape (m,)
        Middle of each window, s, and complex amplitude in the channel's unit. Windows without amplitude carry
        no phase and are left out.
    share : float
        Share of the variance about the polynomial that the sine explains.
    width, hop : float
        Duration of a window, and usual distance of windows, s. None in place of all where fewer than three
        windows are left.
    """
    # coarser sampling needs longer windows
    step = float(np.median(np.diff(t)))
    hop = max(1.0, np.ceil(SAMPLES * step * frequency / WINDOW)) / frequency
    width = WINDOW * hop
    count = int((t[-1] - t[0] - width) / hop * (1 + 1e-9)) + 1
    if count < 3:
        return None
    starts = t[0] + hop * np.arange(count)
    if count > MOST_WINDOWS:
        # pairs of windows that follow each other without overlap, spread over the record
        first = np.linspace(0, count - WINDOW - 1, MOST_WINDOWS // 2).astype(int)
        starts = starts[np.unique(np.concatenate((first, first + WINDOW)))]
    ends = np.searchsorted(t, np.column_stack((starts, starts + width)))
    enough = ends[:, 1] - ends[:, 0] >= max(SAMPLES, 0.5 * width / step)
    if enough.sum() < 3:
        return None
    time = starts[enough] + 0.5 * width
    amplitude, share = _fitted(t, x, ends[enough], time, width, frequency)
    carries = np.abs(amplitude) > np.sqrt(RIDGE) * np.max(np.abs(amplitude))
    if carries.sum() < 3:
        return None
    return time[carries], amplitude[carries], share, width, hop


def _incoherent(time: Array, amplitude: Complex, width: float, hop: float) -> float:
    """Chance that noise of any colour agrees as well from window to window."""
    pairs = [(i, int(j)) for i, j in enumerate(np.searchsorted(time, time + width - 0.5 * hop))]
    pairs = [(i, j) for i, j in pairs if j < len(time) and abs(time[j] - time[i] - width) < 0.1 * hop]
    if len(pairs) < 2:
        return 1.0
    i, j = np.array(pairs).T
    inner = abs(np.vdot(amplitude[i], amplitude[j]))
    size = float(np.sqrt(np.sum(np.abs(amplitude[i]) ** 2) * np.sum(np.abs(amplitude[j]) ** 2)))
    coherence = min(inner / max(size, 1e-300), 1.0)
    # windows that overlap by a half count as two thirds of one
    independent = len(pairs) * 2.0 / 3.0
    return float((1.0 - coherence**2) ** max(independent - 1.0, 0.0))


def _slepian_tapers(count: int) -> Array:
    """Return the tapers most concentrated within :data:`BAND` cycles a record, shape (TAPERS, count)."""
    from scipy.linalg import eigh_tridiagonal

    k = np.arange(count)
    diagonal = ((count - 1) / 2 - k) ** 2 * np.cos(2 * np.pi * BAND / count)
    beside = k[1:] * (count - k[1:]) / 2
    largest = (count - TAPERS, count - 1)
    return eigh_tridiagonal(diagonal, beside, select="i", select_range=largest)[1].T


def _no_line(t: Array, x: Array, frequency: float) -> float:
    """Chance that noise, alike over :data:`BAND` cycles a record to either side, looks as much like a line.

    Thomson's F test of the amplitudes under orthogonal tapers; the line is sought within a tenth of a cycle.
    """
    from scipy import special

    duration = float(t[-1] - t[0])
    if frequency * duration > LINE_CYCLES:
        return 1.0
    count = round(duration / float(np.median(np.diff(t)))) + 1
    even = np.linspace(t[0], t[-1], count)
    u = 2.0 * (even - t[0]) / duration - 1.0
    values = np.interp(even, t, x)
    # a hole of more than a quarter of a cycle is filled with the line itself, and tells nothing
    after = np.clip(np.searchsorted(t, even), 1, len(t) - 1)
    known = t[after] - t[after - 1] <= 0.25 / frequency
    if known.mean() < KNOWN:
        return 1.0
    design = np.column_stack((np.vander(u, DRIFT + 1), waves(even, frequency)))
    weights = np.linalg.lstsq(design[known], values[known], rcond=None)[0]
    values = np.where(known, values, design @ weights)
    values = values - np.polyval(np.polyfit(u, values, DRIFT), u)
    tapers = _slepian_tapers(count)
    sums = tapers.sum(axis=1)
    best = 0.0
    for near in frequency + np.array([-0.1, -0.05, 0.0, 0.05, 0.1]) / duration:
        tapered = tapers @ (values * np.exp(-2j * np.pi * near * (even - t[0])))
        line = sums @ tapered / (sums @ sums)
        left = float(np.sum(np.abs(tapered - line * sums) ** 2))
        best = max(best, (TAPERS - 1) * abs(line) ** 2 * float(sums @ sums) / max(left, 1e-300))
    best *= float(known.mean())
    return float(special.fdtrc(2, 2 * TAPERS - 2, best))


def _fitted(
    t: Array, x: Array, ends: NDArray[np.intp], middles: Array, width: float, frequency: float
) -> tuple[Complex, float]:
    """Complex amplitude of a frequency in each window, and its share of the variance about the drift."""
    rows = ends[:, :1] + np.arange(int(np.max(ends[:, 1] - ends[:, 0])))
    inside = rows < ends[:, 1:]
    rows = np.minimum(rows, len(t) - 1)
    u = (t[rows] - middles[:, None]) / (0.5 * width)
    drift = [np.polynomial.legendre.legval(u, np.eye(DRIFT + 1)[k]) for k in range(DRIFT + 1)]
    phase = 2 * np.pi * frequency * (t[rows] - t[0])
    design = np.stack([*drift, np.cos(phase), -np.sin(phase)], axis=-1) * inside[..., None]
    values = np.where(inside, x[rows] - np.mean(x[rows], axis=1, keepdims=True), 0.0)
    normal = np.einsum("wli,wlj->wij", design, design)
    normal += 1e-12 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(normal.shape[1])
    right = np.einsum("wli,wl->wi", design, values)[..., None]
    weights = np.linalg.solve(normal, right)[..., 0]
    amplitude = weights[:, DRIFT + 1] + 1j * weights[:, DRIFT + 2]
    # what the sine explains beyond the drift
    d = DRIFT + 1
    level = np.linalg.solve(normal[:, :d, :d], right[:, :d])
    drifted = float(np.sum(right[:, :d] * level))
    whole = float(np.sum(values**2)) - drifted
    return amplitude, (float(np.sum(right[..., 0] * weights)) - drifted) / max(whole, 1e-300)


def _slope(time: Array, phase: Array, size: Array) -> tuple[float, float]:
    """Slope of phases over time and its standard error, by restricted maximum likelihood.

    The phases' covariance is that of overlapping windows of white noise, each as noisy as its amplitude is
    small, and of a random walk, in a proportion that the likelihood tells.
    """
    from scipy.linalg import eigh

    n = len(time)
    hop = float(np.min(np.diff(time)))
    hops = np.abs(time[:, None] - time[None, :]) / hop
    noise = np.clip(1.0 - hops / WINDOW, 0.0, 1.0) * np.outer(np.mean(size) / size, np.mean(size) / size)
    walk = (np.minimum.outer(time, time) - time[0]) / hop
    # in coordinates where both covariances are diagonal
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
    """Periodogram of a record at given frequencies, by FFT where its steps are even."""
    steps = np.diff(t)
    step = float(np.mean(steps))
    if np.ptp(steps) > 1e-3 * step:
        from scipy.signal import lombscargle

        # scipy builds arrays of frequencies times samples: in parts they do not grow with the square of the
        # length
        parts = np.array_split(2 * np.pi * grid, 1 + len(t) * len(grid) // 1_000_000)
        return np.concatenate([lombscargle(t, x, part) for part in parts])
    count = 1 << int(np.ceil(np.log2(20 * len(x))))
    return np.interp(grid, np.fft.rfftfreq(count, step), np.abs(np.fft.rfft(x, count)) ** 2)
