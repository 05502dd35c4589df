"""The recoil law and the surge model, against the boxfish paper's figures and independent data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from swimid.errors import InputError
from swimid.fitting import output_error
from swimid.fitting.model import CruiseInput, Trial
from swimid.kinematics.frequency import find_beat
from swimid.logs import log
from swimid.propulsion import model as propulsion
from swimid.propulsion.trials import beat_averages
from swimid.results import evidence, parameters
from swimid.robots import file as robot_format
from tests.conftest import Ran
from tests.generators import cruise
from tests.generators.files import write_log, write_trials

CRUISE = "format: swimid-trials/1\nexperiment: cruise\nrobot: boxfish\ntable: speeds.csv\n"
#: The paper's C_d, A, m_f + m_a.
DRAG_AREA = 0.5 * 997 * 0.705 * 0.00698
MOVING = 1.196 + 0.685


@pytest.fixture(scope="module")
def drag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drag file with the paper's values and errors."""

    def known(value: float, stderr: float, unit: str) -> parameters.Estimate:
        return parameters.Estimate(value=value, stderr=stderr, unit=unit, status="estimated")

    path = tmp_path_factory.mktemp("drag") / "drag.yaml"
    estimates = {"drag_coefficient": known(0.705, 0.0165, "1"), "added_mass": known(0.685, 0.0185, "kg")}
    parameters.ParameterFile(model="falling-weight", robot="boxfish", parameters=estimates).write(path)
    return path


class TestPublishedFigures:
    def test_velocity_ratio(self) -> None:
        """Section 4.2: b1 = 0.0130 per cm, R_v(0, 115 cm) = 0.688, 1.05 % for 4 cm."""
        b1 = DRAG_AREA / MOVING
        assert b1 == pytest.approx(1.30, abs=0.005)
        ratio = float(propulsion.velocity_ratio(b1, 1.15))
        assert ratio == pytest.approx(0.688, abs=5e-4)
        assert float(propulsion.velocity_ratio(b1, 1.19)) / ratio - 1 == pytest.approx(0.0105, abs=0.001)

    def test_velocity_ratio_against_integration(self) -> None:
        run = solve_ivp(
            lambda _, s: [s[1], 1.0 - 1.3 * s[1] ** 2],
            (0, 30),
            [0, 0],
            rtol=1e-10,
            atol=1e-12,
            dense_output=True,
        )
        t = np.linspace(0, 5, 200001)
        x = run.sol(t)[0]
        expected = 1.15 / np.interp(1.15, x, t) / np.sqrt(1 / 1.3)
        assert float(propulsion.velocity_ratio(1.3, 1.15)) == pytest.approx(expected, rel=1e-6)

    def test_inertia_of_the_fins(self) -> None:
        """Eq 6 with Table 2: 317.1, 702.8 and 1272.8 g cm2."""
        fins = robot_format.read("boxfish").fins
        for name, value in (("2025Rect", 317.1), ("2925Rect", 702.8), ("3825Rect", 1272.8)):
            fin = fins[name]
            found = propulsion.plate_inertia(fin.height_m, fin.length_m, fin.axle_gap_m, 997)
            assert 1e7 * found == pytest.approx(value, abs=0.06)

    def test_largest_and_smallest_force(self) -> None:
        """3825Rect at 4 Hz: 9.67 -> 14.06 cm/s -> 48.42 mN; 2025Rect at 1.5 Hz: 2.81 mN, 2.87 by the law."""
        terminal = 0.0967 / float(propulsion.velocity_ratio(DRAG_AREA / MOVING, 1.15))
        assert terminal == pytest.approx(0.1406, abs=1e-4)
        assert 1e3 * DRAG_AREA * terminal**2 == pytest.approx(48.42, abs=0.1)
        power = 8 * 0.341 * np.pi**2 * 1.5**3 * 317.1e-7 * np.deg2rad(16 - 5.42) ** 2
        assert 1e3 * DRAG_AREA * np.cbrt(power / DRAG_AREA) ** 2 == pytest.approx(2.87, abs=0.01)

    def test_strouhal_conventions(self) -> None:
        """With efficiency 34.1 %: 0.67-0.77 on the fin's length, 0.77-0.94 from the axle."""
        found = {"fin": [], "axle": []}
        for fin in ("2025Rect", "2925Rect", "3825Rect"):
            f = robot_format.read("boxfish").fins[fin]
            inertia = propulsion.plate_inertia(f.height_m, f.length_m, f.axle_gap_m, 997)
            terminal = np.cbrt(
                8 * 0.341 * np.pi**2 * 2.0**3 * inertia * np.deg2rad(16 - 5.42) ** 2 / DRAG_AREA
            )
            for name, lever in (("fin", f.length_m), ("axle", f.length_m + f.axle_gap_m)):
                found[name].append(float(propulsion.strouhal(2.0, np.deg2rad(16), lever, terminal)))
        assert (min(found["fin"]), max(found["fin"])) == pytest.approx((0.67, 0.77), abs=0.01)
        assert (min(found["axle"]), max(found["axle"])) == pytest.approx((0.77, 0.94), abs=0.01)


@pytest.mark.parametrize(("noise", "status"), [(0.06, "estimated"), (0.09, "unidentifiable")])
def test_an_offset_of_zero_is_known_to_a_degree(noise: float, status: str) -> None:
    """An offset is not identifiable if its standard error exceeds half of its typical size, 2 degrees."""
    model = propulsion.RecoilModel(drag_area_kg_m=2.4, moving_mass_kg=1.9, fins={"a": 1e-4})
    inputs = {
        "frequency_hz": np.tile([1.5, 2.0, 2.5, 3.0], 3),
        "amplitude_rad": np.deg2rad(np.repeat([8.0, 12.0, 20.0], 4)),
        "distance_m": np.ones(12),
    }
    cruise = CruiseInput(fin="a", inertia_kg_m2=1e-4, middle=(2.25, 0.25))
    runs = Trial("a", "fit", np.arange(12.0), {}, inputs=inputs, cruise=cruise)
    speed = model.simulate(np.array([0.3, 0.0, 3.0, 2.0]), runs)["mean_speed_m_s"]
    # the error does not change with frequency or amplitude
    errors = noise * np.array([1, -1, -1, 1, -1, 1, 1, -1, 1, -1, -1, 1])
    found = output_error.fit_output_error(
        model, [replace(runs, measured={"mean_speed_m_s": speed * (1 + errors)})]
    )
    assert abs(found.value("amplitude_offset_deg")) < 0.1
    assert found.status["amplitude_offset_deg"] == status
    assert found.status["recoil_efficiency"] == "estimated"


class TestCruise:
    def test_the_sample_gives_the_published_values(
        self, swimid: Callable[..., Ran], samples: Path, drag: Path, tmp_path: Path
    ) -> None:
        out = tmp_path / "propulsion.yaml"
        ran = swimid("fit-propulsion", samples / "cruise" / "trials.yaml", "--drag", drag, "-o", out)
        assert ran.status == 0, ran.err
        file = parameters.read(out, model="propulsion")
        efficiency, offset = file.parameters["recoil_efficiency"], file.parameters["amplitude_offset_deg"]
        assert efficiency.value == pytest.approx(cruise.EFFICIENCY, abs=0.02)
        assert offset.value == pytest.approx(5.4, abs=0.4)
        assert abs(offset.value - cruise.OFFSET_DEG) < 3 * offset.stderr  # type: ignore[operator]
        # The errors of the drag file contribute: eta ~ C_d / R_v^3 and d ln R_v / d ln b1 = 0.30 (the paper's
        # 1.05 % for 3.5 %), so that C_d nearly cancels and the mass has the exponent 0.9.
        from_drag = np.hypot(0.1 * 0.0165 / 0.705, 0.9 * 0.0185 / 1.881)
        assert efficiency.stderr == pytest.approx(0.341 * from_drag, rel=0.3)
        assert file.derived["velocity_ratio"].value == pytest.approx(0.688, abs=5e-4)
        extra = file.fit.model_extra  # type: ignore[union-attr]
        point = next(
            p for p in extra["operating_points"] if (p["fin"], p["frequency_hz"]) == ("3825Rect", 4.0)
        )
        # the error of the stop watch, 0.05 s of 11.9 s, is 0.8 % of the force
        assert 1e3 * point["propulsive_force_N"] == pytest.approx(48.4, rel=0.03)
        assert [d["frequency_hz"] for d in extra["departures"]] == [4.0]
        assert "SWM030" in ran.err
        assert "slower" in ran.err
        page = evidence.read(evidence.sidecar(out))
        assert [t.id for t in page.tables] == ["points"]
        assert page.figures[0].id == "speeds"
        (departed,) = [c for c in page.checks if c.name == "every frequency follows the law"]
        assert (departed.verdict, departed.value[:5]) == ("warn", "4 Hz:")
        assert "with these frequencies recoil_efficiency" in departed.text

    @pytest.mark.slow
    def test_intervals_cover_the_truth(
        self, swimid: Callable[..., Ran], samples: Path, tmp_path: Path
    ) -> None:
        """40 seeded tables without flexing fins: 95 % intervals of both parameters."""
        exact = parameters.ParameterFile(
            model="falling-weight",
            parameters={
                n: parameters.Estimate(value=v, stderr=0.0, unit=u, status="estimated")
                for n, v, u in (("drag_coefficient", 0.705, "1"), ("added_mass", 0.685, "kg"))
            },
        )
        exact.write(tmp_path / "drag.yaml")
        times = {
            s: cruise.swim_time(cruise.fin_inertia(*cruise.FINS[s[0]]), s[1], s[2]) for s in cruise.settings()
        }
        hits = np.zeros(2)
        for seed in range(40):
            rng = np.random.default_rng(seed)
            rows = [(*s, 1.15, t + rng.normal(0, 0.1)) for s, t in times.items()]
            cruise.write_table(tmp_path / "speeds.csv", rows)
            (tmp_path / "trials.yaml").write_text((samples / "cruise" / "trials.yaml").read_text())
            p = swimid(
                "fit-propulsion", tmp_path / "trials.yaml", "--drag", tmp_path / "drag.yaml", "--json"
            ).json["result"]["parameters"]
            for i, (name, true) in enumerate((("recoil_efficiency", 0.341), ("amplitude_offset_deg", 5.42))):
                hits[i] += abs(p[name]["value"] - true) < 1.96 * p[name]["stderr"]
        # 40 draws at 95 % give at least 33 with 99 % probability
        assert np.all(hits >= 33), hits

    @pytest.mark.slow
    def test_an_exponent_other_than_that_of_the_law_is_reported(
        self, swimid: Callable[..., Ran], drag: Path, tmp_path: Path, rng: np.random.Generator
    ) -> None:
        """Speeds grow with frequency to the power 0.8, so that the exponent of the power is 2.4, not 3."""
        rows = []
        for fin, f, a in cruise.settings():
            t = cruise.swim_time(cruise.fin_inertia(*cruise.FINS[fin]), 2.5, a) * (f / 2.5) ** -0.8
            rows.append((fin, f, a, 1.15, t + rng.normal(0, 0.05)))
        cruise.write_table(tmp_path / "speeds.csv", rows)
        (tmp_path / "trials.yaml").write_text(CRUISE)
        ran = swimid(
            "fit-propulsion", tmp_path / "trials.yaml", "--drag", drag, "--json", "--keep-departures"
        )
        assert "SWM031" in ran.err
        free = ran.json["result"]["derived"]["free_frequency_exponent"]
        assert free["value"] == pytest.approx(2.4, abs=0.05)
        assert free["status"] == "estimated"

    def test_no_exponent_is_known_with_the_offset_at_its_bound(
        self, swimid: Callable[..., Ran], drag: Path, tmp_path: Path, rng: np.random.Generator
    ) -> None:
        """The speed grows with (amplitude + 13 deg)^(2/3); the lowest offset that is allowed is -10 deg."""
        rows = []
        for fin, f, a in cruise.settings():
            t = 12.0 * (f / 2.5) ** -1.0 * ((a + 13.0) / 29.0) ** (-2.0 / 3.0)
            rows.append((fin, f, a, 1.15, t + rng.normal(0, 0.02)))
        cruise.write_table(tmp_path / "speeds.csv", rows)
        (tmp_path / "trials.yaml").write_text(CRUISE)
        out = tmp_path / "p.yaml"
        swimid("fit-propulsion", tmp_path / "trials.yaml", "--drag", drag, "--keep-departures", "-o", out)
        file = parameters.read(out)
        assert file.parameters["amplitude_offset_deg"].status == "at-bound"
        assert file.derived["free_frequency_exponent"].status == "unidentifiable"
        checks = {c.name: c for c in evidence.read(evidence.sidecar(out)).checks}
        assert checks["frequency exponent"].value == "not identifiable"

    @pytest.mark.parametrize(
        "table, words",
        [
            (
                "fin,frequency_hz,amplitude_deg,distance_m,time_s\n3825Rct,2,16,1.15,20\n",
                ["no fin '3825Rct'", "did you mean '3825Rect'"],
            ),
            (
                "fin,frequency_hz,amplitude_deg,distance_m,time_s\n3825Rect,2,16,1.15,abc\n",
                ["line 2", "time_s"],
            ),
        ],
    )
    def test_errors_of_a_table_name_their_place(
        self, swimid: Callable[..., Ran], drag: Path, tmp_path: Path, table: str, words: list[str]
    ) -> None:
        (tmp_path / "speeds.csv").write_text(table)
        (tmp_path / "trials.yaml").write_text(CRUISE)
        ran = swimid("fit-propulsion", tmp_path / "trials.yaml", "--drag", drag)
        assert ran.status == 3
        for word in words:
            assert word in ran.err

    def test_a_cruise_needs_a_drag_file(self, swimid: Callable[..., Ran], samples: Path) -> None:
        ran = swimid("fit-propulsion", samples / "cruise" / "trials.yaml")
        assert ran.status == 3
        assert "run fit-drag first" in ran.err

    def test_one_run_identifies_nothing(self, swimid: Callable[..., Ran], drag: Path, tmp_path: Path) -> None:
        cruise.write_table(tmp_path / "speeds.csv", [("3825Rect", 2.0, 16.0, 1.15, 20.0)])
        (tmp_path / "trials.yaml").write_text(CRUISE)
        assert swimid("fit-propulsion", tmp_path / "trials.yaml", "--drag", drag).status == 4


class TestBeat:
    def test_frequency_and_error(self) -> None:
        inside = 0
        for seed in range(50):
            rng = np.random.default_rng(seed)
            t = np.sort(rng.uniform(0, 12, 300))
            x = 0.1 * np.sin(2 * np.pi * 1.83 * t + 1.0) + 0.02 * t + rng.normal(0, 0.05, 300)
            beat = find_beat(t, x)
            assert beat is not None
            inside += abs(beat.frequency_hz - 1.83) < 1.96 * beat.stderr_hz
        assert inside >= 47

    def test_noise_has_no_beat(self, rng: np.random.Generator) -> None:
        assert find_beat(np.arange(0, 10, 0.03), rng.normal(size=334)) is None
        assert find_beat(np.arange(0, 10, 0.03), np.zeros(334)) is None
        assert find_beat(np.arange(5.0), np.ones(5)) is None


class TestBeatAverages:
    @staticmethod
    def _log(heading: float) -> log.Log:
        """Return six seconds at 0.2 m/s along a heading, with a yaw of 2 Hz wrapped into -pi .. pi."""
        t = np.arange(0, 6, 0.02)
        yaw = heading + 0.3 * np.sin(4 * np.pi * t)
        yaw = (yaw + np.pi) % (2 * np.pi) - np.pi
        columns = {
            "t_s": t,
            "x_m": 0.2 * np.cos(heading) * t,
            "y_m": 0.2 * np.sin(heading) * t,
            "yaw_rad": yaw,
        }
        return log.Log(Path("swim.csv"), {}, columns)

    @pytest.mark.parametrize("heading", [0.0, np.pi, -3.0])
    def test_the_heading_may_wrap(self, heading: float) -> None:
        _, speed = beat_averages(self._log(heading), 0.5)
        assert speed == pytest.approx(0.2, rel=1e-3)

    def test_beats_that_the_log_does_not_resolve_are_an_error(self) -> None:
        with pytest.raises(InputError, match="a beat needs at least 2"):
            beat_averages(self._log(0.0), 0.01)


def write_real_fish(folder: Path, data: Path, *, frequency_hz: float, own_speed: bool = True) -> Path:
    """Write the straight runs of the tail-actuated fish as logs with a trials file."""
    lines = []
    (folder / "fish.yaml").write_text("format: swimid-robot/1\nname: tail-fish\n")
    for amplitude in (15, 20, 30):
        for run in (1, 2):
            rows = np.loadtxt(data / "msu_tail_fish" / f"Amp{amplitude}Bias0" / f"STATES{run}.txt")
            columns = {"t_s": 0, "x_m": 5, "y_m": 6, "yaw_rad": 4} | ({"u_m_s": 1} if own_speed else {})
            write_log(folder / f"a{amplitude}_{run}.csv", {n: rows[:, k] for n, k in columns.items()})
            lines.append(
                f"log: a{amplitude}_{run}.csv, "
                f"drive: {{frequency_hz: {frequency_hz}, amplitude_deg: {amplitude}}}"
            )
    return write_trials(folder / "trials.yaml", "free-swim", "fish.yaml", lines)


class TestRealFish:
    @pytest.mark.parametrize("own_speed", [True, False], ids=["logged surge", "surge from position"])
    def test_thrust_grows_with_amplitude_squared(
        self, swimid: Callable[..., Ran], real_data: Path, tmp_path: Path, own_speed: bool
    ) -> None:
        """Beat-averaged: du/dt = 0.166 A^2 - 0.656 u^2 by an independent fit; exponent 2.0 to 2.3."""
        ran = swimid(
            "fit-propulsion",
            write_real_fish(tmp_path, real_data, frequency_hz=2.0, own_speed=own_speed),
            "--json",
        )
        result = ran.json["result"]
        drag, thrust = result["parameters"]["surge_drag"], result["derived"]["thrust_coefficient"]
        exponent = result["derived"]["free_amplitude_exponent"]["value"]
        assert 2.0 <= exponent <= 2.3
        assert abs(drag["value"] - 0.656) < 1.96 * drag["stderr"]
        assert abs(thrust["value"] - 0.166) < 1.96 * thrust["stderr"]
        if own_speed:
            assert drag["value"] == pytest.approx(0.66, rel=0.10)
        assert "SWM032" not in ran.err

    def test_a_wrong_stated_beat_is_reported(
        self, swimid: Callable[..., Ran], real_data: Path, tmp_path: Path
    ) -> None:
        ran = swimid("fit-propulsion", write_real_fish(tmp_path, real_data, frequency_hz=1.0), "--json")
        assert ran.json["result"]["derived"]["beat_frequency"]["value"] == pytest.approx(2.0, abs=0.05)
        flagged = [w for w in ran.json["warnings"] if w["code"] == "SWM032"]
        assert len(flagged) == 6
        assert all("says 1 Hz" in w["text"] for w in flagged)


def write_straight_runs(folder: Path, *, held_out_speed_m_s: float) -> Path:
    """Straight runs of a body with known thrust and drag; the held-out one is logged from full swing on.

    The surge is that of du/dt = 0.25 (A/0.35)^2 (1 - cos(4 pi f t)) - 1.1 u |u|, integrated by
    an adaptive method; the thrust comes twice a beat.
    """
    lines = []
    (folder / "fish.yaml").write_text("format: swimid-robot/1\nname: straight-fish\n")
    rng = np.random.default_rng(5)
    for name, amplitude, begun, role in (
        ("slow", 15, 0.0, "fit"),
        ("mid", 20, 0.0, "fit"),
        ("fast", 30, 0.1, "fit"),
        ("held", 25, held_out_speed_m_s, "validate"),
    ):
        push = 0.25 * (np.deg2rad(amplitude) / 0.35) ** 2

        def rate(t: float, u: np.ndarray, push: float = push) -> np.ndarray:
            return push * (1 - np.cos(8 * np.pi * t)) - 1.1 * u * np.abs(u)

        t = np.arange(0, 12, 0.02)
        u = solve_ivp(rate, (0, 12), [begun], t_eval=t, rtol=1e-8).y[0] + 0.002 * rng.normal(size=len(t))
        yaw = 0.2 * np.sin(4 * np.pi * t) + 0.005 * rng.normal(size=len(t))
        write_log(
            folder / f"{name}.csv",
            {"t_s": t, "x_m": np.cumsum(u) * 0.02, "y_m": 0 * t, "yaw_rad": yaw, "u_m_s": u},
        )
        lines.append(
            f"id: {name}, log: {name}.csv, role: {role}, "
            f"drive: {{frequency_hz: 2.0, amplitude_deg: {amplitude}}}"
        )
    return write_trials(folder / "trials.yaml", "free-swim", "fish.yaml", lines)


class TestStartStates:
    def test_the_start_speed_of_held_out_trials_is_estimated(
        self, swimid: Callable[..., Ran], tmp_path: Path
    ) -> None:
        ran = swimid("fit-propulsion", write_straight_runs(tmp_path, held_out_speed_m_s=0.6), "--json")
        fit = ran.json["result"]["fit"]
        assert ran.json["result"]["parameters"]["surge_drag"]["value"] == pytest.approx(1.1, rel=0.03)
        held_out = fit["validation"]["channels"]["u_m_s"]["rmse"]
        assert held_out < 1.5 * fit["channels"]["u_m_s"]["rmse"]
        assert "SWM015" not in ran.err

    def test_trials_start_at_rest_on_request(self, swimid: Callable[..., Ran], tmp_path: Path) -> None:
        trials = write_straight_runs(tmp_path, held_out_speed_m_s=0.6)
        ran = swimid("fit-propulsion", trials, "--fix", "initial_speed=0", "--json")
        assert "initial_speed[fast]" not in ran.json["result"]["parameters"]
        assert "SWM015" in ran.err


class TestStatedRamp:
    def test_beats_within_a_ramp_are_left_out(self, swimid: Callable[..., Ran], tmp_path: Path) -> None:
        path = write_straight_runs(tmp_path, held_out_speed_m_s=0.0)
        whole = swimid("fit-propulsion", path, "--json").json["result"]["fit"]["samples"]
        path.write_text(path.read_text().replace("amplitude_deg", "ramp_s: 3.0, amplitude_deg"))
        assert swimid("fit-propulsion", path, "--json").json["result"]["fit"]["samples"] == whole - 3 * 6
