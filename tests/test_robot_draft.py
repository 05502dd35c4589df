"""``swimid robot``: robot files from MJCF and URDF, whose motion without water is that of MuJoCo."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from swimid.robots import file as robot_format
from tests.test_simulators import FISH

mujoco = pytest.importorskip("mujoco")

ARM = """<mujoco model="arm">
  <option timestep="0.002" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" type="hinge" axis="0 1 0" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" density="800"/>
      <body name="fore" pos="0.3 0 0">
        <joint name="elbow" type="hinge" axis="0 1 0" damping="0.03"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0.02" size="0.025" density="800"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m1" joint="shoulder" gear="2"/><position name="p2" joint="elbow" kp="8" kv="0.3"/>
  </actuator>
</mujoco>
"""
LEG = """
<body name="{0}" pos="{1} 0 0"><joint name="{0}_hip"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.4"/>
  <body name="{0}_shin" pos="0 0 -0.2"><joint name="{0}_knee"/>
    <geom type="capsule" fromto="0 0 0 -0.05 0 -0.18" size="0.015" mass="0.2"/></body></body>"""
QUADRUPED = f"""<mujoco model="quadruped">
  <option timestep="0.002" gravity="0 0 -9.81"/>
  <default><joint type="hinge" axis="0 1 0" damping="0.1"/><position kp="20" kv="0.5"/></default>
  <worldbody><body name="trunk" pos="0 0 0.5"><freejoint name="root"/>
    <geom type="box" size="0.25 0.1 0.06" mass="6"/>{LEG.format("fore", 0.2)}{LEG.format("hind", -0.2)}
  </body></worldbody>
  <actuator><position name="a" joint="fore_hip"/><position name="b" joint="hind_knee"/></actuator>
</mujoco>
"""
ROV = """<mujoco model="rov">
  <option timestep="0.005" density="1000" gravity="0 0 0"/>
  <worldbody><body name="hull"><freejoint name="root"/>
    <geom type="box" size="0.23 0.17 0.13" density="980"/>
    <geom type="cylinder" pos="0.1 0 0" size="0.04 0.1"/>
    <site name="camera" pos="0.2 0 0.05"/></body></worldbody>
</mujoco>
"""


def _snake() -> str:
    bodies = ""
    for k in range(4):
        joint = f'<joint name="j{k}" type="hinge" axis="0 0 {(-1) ** k}" damping="0.002" stiffness="0.01"/>'
        bodies += f'<body name="s{k}" pos="{-0.12 if k else 0} 0 0">{joint if k else "<freejoint/>"}'
        bodies += '<geom type="capsule" fromto="0 0 0 -0.12 0 0" size="0.02" density="900"/>'
    tendon = '<fixed name="t"><joint joint="j1" coef="0.02"/><joint joint="j2" coef="-0.02"/></fixed>'
    return (
        f'<mujoco model="snake"><option gravity="0 0 0"/><worldbody>{bodies}{"</body>" * 4}</worldbody>'
        f'<tendon>{tendon}</tendon><actuator><motor name="pull" tendon="t" gear="1"/></actuator></mujoco>'
    )


PENDULUM = """<robot name="pendulum">
  <link name="post"><inertial><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="rod"><inertial><origin xyz="0 0 -0.2"/><mass value="0.5"/>
    <inertia ixx="0.007" iyy="0.007" izz="0.0001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="swing" type="continuous"><parent link="post"/><child link="rod"/>
    <origin xyz="0 0 1"/><axis xyz="0 1 0"/><dynamics damping="0.02"/></joint>
</robot>
"""


@pytest.mark.parametrize(
    "name, text, options, coordinates",
    [
        ("fish.xml", FISH, (), 5),
        ("arm.xml", ARM, (), 2),
        ("quadruped.xml", QUADRUPED, (), 7),
        ("rov.xml", ROV, (), 3),
        ("snake.xml", _snake(), (), 6),
        ("pendulum.urdf", PENDULUM, ("--fixed",), 1),
    ],
)
def test_without_water_it_moves_as_in_mujoco(swimid, tmp_path, name, text, options, coordinates):
    (tmp_path / name).write_text(text)
    ran = swimid("robot", tmp_path / name, *options, "-o", tmp_path / "robot.yaml", "--json")
    assert ran.status == 0, ran.err
    result = ran.json["result"]
    assert len(result["differences"]) == coordinates
    # Both integrate with small steps; the rest is that MuJoCo holds a command over a step of 0.5 ms.
    assert max(result["differences"].values()) < 2e-4
    robot_format.read(str(tmp_path / "robot.yaml"))


def test_a_robot_that_leaves_the_plane_is_stated(swimid, tmp_path):
    (tmp_path / "tilted.xml").write_text(QUADRUPED.replace('pos="0.2 0 0"', 'pos="0.2 0.15 0"'))
    ran = swimid("robot", tmp_path / "tilted.xml")
    assert "CAUTION" in ran.out


def test_added_mass_is_that_of_mujoco_for_an_ellipsoid(swimid, tmp_path):
    (tmp_path / "fish.xml").write_text(FISH)
    swimid("robot", tmp_path / "fish.xml", "-o", tmp_path / "robot.yaml")
    elements = yaml.safe_load((tmp_path / "robot.yaml").read_text())["multilink"]["elements"]
    head = next(e for e in elements if e["kind"] == "added-mass" and e["link"] == "head")
    fluid = mujoco.MjModel.from_xml_string(FISH).geom_fluid[0]
    for key, at in (("surge_kg", 6), ("sway_kg", 7), ("inertia_kg_m2", 11)):
        # MuJoCo integrates Lamb's integrals with its own rule; the file has four digits.
        assert float(head[key].split(" * ")[0]) == pytest.approx(1000.0 * fluid[at], rel=1e-3)


def test_the_drafted_fish_swims_with_its_commands(swimid, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("fish.xml").write_text(FISH)
    ran = swimid("robot", "fish.xml", "-o", "robot.yaml")
    assert "ASK columns of the log of the actuators: cmd_servo" in ran.out
    assert "c_ma" in Path("robot.yaml").read_text()
    assert "not expressed" not in ran.out.replace("contacts", "")


def test_init_takes_the_only_file_of_the_folder(swimid, tmp_path, samples):
    lab = tmp_path / "lab"
    lab.mkdir()
    (lab / "fish.xml").write_text(FISH)
    for log in ("f10a20.csv", "f14a25.csv"):
        (lab / log).write_text((samples / "tfish" / log).read_text())
    ran = swimid("init", lab, "-o", tmp_path / "project", "--experiment", "free-swim")
    assert ran.status == 0, ran.err
    assert "robot.yaml is drafted from fish.xml" in ran.out
    links = robot_format.read(str(tmp_path / "project" / "robot.yaml")).multilink.links
    assert [link.name for link in links] == ["head", "peduncle", "fin"]


def test_init_keeps_the_questions_of_a_rig_beside_such_a_file(swimid, tmp_path, samples):
    lab = tmp_path / "lab"
    lab.mkdir()
    (lab / "fish.xml").write_text(FISH)
    for log in ("w10.csv", "w20.csv"):
        (lab / log).write_text((samples / "rig" / log).read_text())
    ran = swimid("init", lab, "-o", tmp_path / "project", "--experiment", "falling-weight")
    assert ran.status == 0, ran.err
    assert "drafted from fish.xml" not in ran.out
    assert "ASK" in (tmp_path / "project" / "robot.yaml").read_text()


@pytest.mark.parametrize(
    "change, text",
    [
        (('<joint name="fin" ', '<joint name="fin" axis="1 0 0" '), "are not parallel"),
        (('<joint name="fin" ', '<joint name="fin" type="slide" '), "is not a hinge"),
        (('<joint name="fin" ', '<joint name="extra" type="hinge"/><joint name="fin" '), "has 2 joints"),
    ],
)
def test_a_robot_that_it_cannot_express_is_refused(swimid, tmp_path, change, text):
    (tmp_path / "fish.xml").write_text(FISH.replace(*change))
    ran = swimid("robot", tmp_path / "fish.xml")
    assert ran.status == 3
    assert text in ran.err
    assert "fish.xml" in ran.err
