"""The explorer: its page, its command, and its scripts against Python and certified balls.

Its scripts are asked by node here, and by a browser where there is one (a campaign).
"""

import json
import os
import re
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import MISSING, Browser, browser
from campaign import many
from commands import assert_one_sentence, run
from explorer import (
    ANSWERS,
    NODE,
    asked_of_node,
    curve_cases,
    hostile_state,
    loop_of,
    random_setup,
    setups_with_walls,
    true_curve,
)

import jaxstab
from jaxstab.app.explore import SCRIPTS, explorer_page, script
from jaxstab.app.scene import Scene, simulate_contacts
from jaxstab.app.scene import loop_of as scene_loop

SCENES = sorted((Path(__file__).parents[3] / "data" / "scenes").glob("*.toml"))
LARGEST_PAGE = 1.8e6  # bytes
WITHIN_REACH = 20.0  # alpha and beta of stable walls are below 4
needs_node = pytest.mark.skipif(NODE is None, reason="there is no node here")
OWN_AXE = os.environ.get("JAXSTAB_AXE")  # a file axe.min.js, in place of the one that is installed
POINTS = many(100_000)  # asked in a browser


def page_of(table: dict[str, Any]) -> str:
    device, controller = {"mass": 0.1, "damping": 1.0}, {"sample_time": 1e-3}
    return explorer_page(Scene.from_table({"device": device, "controller": controller} | table))


def initial_of(page: str) -> Any:
    """What the page begins with, as a browser reads it."""
    found = re.search(r'<script type="application/json" id="initial">(.*?)</script>', page, re.S)
    assert found is not None
    return json.loads(found[1])


# ------------------------------------------------------------------------------------ the page


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_a_page_is_one_small_file_that_asks_for_nothing(scene: Path) -> None:
    page = explorer_page(Scene.from_file(scene))
    assert len(page.encode()) < LARGEST_PAGE
    assert set(re.findall(r"https?://[^\"'\s]+", page)) == {"http://www.w3.org/2000/svg"}
    assert not re.search(r"\b(src|href)=\"(?!#|data:)", page)
    assert "default-src 'none'" in page


def test_a_page_begins_with_the_numbers_of_the_scene() -> None:
    state = initial_of(explorer_page(Scene.from_file(SCENES[0].parent / "omega.toml")))["state"]
    known = {"mass": 0.25, "damping": 0.1, "period": 1e-3, "delay": 1.0, "window": 20}
    assert {name: state[name] for name in known} == known
    assert [wall["name"] for wall in state["walls"]] == ["chai3d", "soft"]
    assert state["cursorStiffness"] == pytest.approx(1017.0, rel=0.05)  # half of the stiffest


def test_names_of_walls_do_not_end_the_script() -> None:
    name = "a</script><script>alert(1)</script>"
    page = page_of({"walls": {name: {"stiffness": 100.0, "damping": 1.0}}})
    assert initial_of(page)["state"]["walls"][0]["name"] == name
    counted = _Tags()
    counted.feed(page)
    assert counted.scripts == 2


class _Tags(HTMLParser):
    scripts = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.scripts += tag == "script"


def test_a_device_that_turns_has_its_own_units() -> None:
    table = {"device": {"inertia": 1e-3, "damping": 1e-3}, "hand": {"inertia": [1e-4, 1e-3]}}
    initial = initial_of(page_of(table))
    assert initial["state"]["motion"] == "rotation"
    assert initial["state"]["handMass"] == 1e-4
    assert initial["hands"]["highest"]["handMass"] == 1e-3
    assert initial["units"]["rotation"] == {"stiffness": "N m/rad", "damping": "N m s/rad"}
    assert "lowest values" in " ".join(initial["notes"])


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (
            {"controller": {"sample_time": 1e-3, "position": {"cutoff": 100.0}}},
            r"controller\.position is given",
        ),
        ({"device": {"mass": 0.1, "damping": 1.0, "actuator": {"bandwidth": 300.0}}}, "one mass"),
        ({"controller": {"sample_time": 1e-3, "delay_samples": 300.0}}, "at most 200"),
    ],
)
def test_what_the_page_cannot_compute_is_refused(table: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        page_of(table)


# --------------------------------------------------------------------------------- the command


def test_the_command_writes_a_page_and_says_where(tmp_path: Path) -> None:
    for arguments in ([], [SCENES[0]]):
        output = tmp_path / "walls.html"
        answer = run("explore", *arguments, "-o", output)
        assert answer.exit_code == 0, answer.stderr
        assert answer.stdout == f"{output}\n"
        assert output.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-o", "walls.png"], "ends in neither .html nor .htm"),
        (["-o", "nowhere/walls.html"], "nowhere does not exist"),
        (["none.toml"], "No such file"),
        (["--mass", "1"], "No such option"),
    ],
)
def test_the_command_refuses_in_one_sentence(
    arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    answer = run("explore", *arguments)
    assert answer.exit_code == 2
    assert words in answer.stderr
    if "Usage" not in answer.stderr:
        assert_one_sentence(answer.stderr)
    assert list(tmp_path.iterdir()) == []


# ------------------------------------------------------------------------------ scripts by node


@needs_node
@pytest.mark.parametrize("name", SCRIPTS)
def test_scripts_have_no_errors_of_syntax_and_are_short(name: str, tmp_path: Path) -> None:
    file = tmp_path / f"{name}.js"
    file.write_text(script(name), encoding="utf-8")
    checked = subprocess.run([str(NODE), "--check", str(file)], capture_output=True, check=False)
    assert checked.returncode == 0, checked.stderr
    assert len(script(name).splitlines()) <= 400


def assert_curves_are_true(cases: list[dict[str, Any]], answers: list[Any]) -> int:
    """The number of points that were compared."""
    count = 0
    for case, answer in zip(cases, answers, strict=True):
        points, (truth, moved) = np.array(answer, np.float64), true_curve(case)
        size = np.max(np.abs(truth), axis=1, keepdims=True)
        is_near = size[:, 0] < WITHIN_REACH
        error = np.abs(points - truth) - moved
        assert np.all(error[is_near] <= 1e-12 * size[is_near]), case
        count += int(is_near.sum())
    return count


@needs_node
def test_the_curve_is_that_of_certified_balls(rng: np.random.Generator) -> None:
    cases = curve_cases(rng, 120, 40)
    assert assert_curves_are_true(cases, asked_of_node("curves", cases)) > 1000


def assert_verdicts_are_right(found: list[Any], answers: list[Any]) -> tuple[int, float]:
    """The number of walls that were compared, and the share that the page leaves undecided."""
    undecided, count = 0, 0
    for (loop, _, stiffness, damping), answer in zip(found, answers, strict=True):
        codes, radii, bounds = np.array(answer).T
        proved = loop.verdict(stiffness, damping)
        is_decided = (codes != jaxstab.Verdict.UNDECIDED) & (proved != jaxstab.Verdict.UNDECIDED)
        assert np.all(codes[is_decided] == proved[is_decided])
        radius = loop.spectral_radius(stiffness, damping)
        assert np.all(np.abs(radii - radius.value) <= radius.error + bounds)
        undecided += int(np.sum(codes == jaxstab.Verdict.UNDECIDED))
        count += len(codes)
    return count, undecided / count


@needs_node
def test_verdicts_are_those_that_are_proved(rng: np.random.Generator) -> None:
    found = setups_with_walls(rng, 4, 100)
    answers = asked_of_node("verdicts", [setup for _, setup, *_ in found])
    _, undecided = assert_verdicts_are_right(found, answers)
    assert undecided < 0.3  # half of the walls are next to the boundary


def assert_regions_are_right(setups: list[Any], answers: list[Any]) -> int:
    """The number of regions that the page did not resolve."""
    unresolved = 0
    for setup, answer in zip(setups, answers, strict=True):
        region = loop_of(setup).region()
        if region.status == jaxstab.results.RegionStatus.UNRESOLVED or not answer["isClosed"]:
            unresolved += 1
            continue
        components = region.components
        assert len(components) == len(answer["areas"]), setup
        assert (region.main is not None) == answer["hasMain"], setup
        for component, farthest, area in zip(
            components, answer["farthest"], answer["areas"], strict=True
        ):
            assert area == pytest.approx(component.area, rel=1e-2)
            (stiffest, _), (_, most_damped) = farthest
            size, exact = component.extent, component.stiffest.stiffness
            assert (stiffest is None) == np.isnan(exact), setup
            if stiffest is not None:
                assert abs(stiffest - exact) < 1e-6 * size.stiffness, setup
                assert abs(most_damped - component.most_damped.damping) < 1e-6 * size.damping
    return unresolved


@pytest.mark.campaign
@needs_node
def test_regions_have_the_components_and_extremes_of_the_exact_ones(
    rng: np.random.Generator,
) -> None:
    setups = [random_setup(rng) for _ in range(6)]
    assert assert_regions_are_right(setups, asked_of_node("regions", setups)) == 0


@needs_node
@pytest.mark.parametrize(
    ("mass", "stiffness", "period", "delay", "window"),
    [(0.16, 2380.0, 1.17e-3, 40.0, 40), (0.74, 351000.0, 4.57e-3, 27.7, 30)],
)
def test_small_gains_are_reached_next_to_an_axis(
    mass: float, stiffness: float, period: float, delay: float, window: int
) -> None:
    """Of a spring without damper, late, only walls with hardly any damping are."""
    zeros = dict.fromkeys(("damping", "handMass", "handDamping"), 0.0)
    estimator = {"window": window, "cutoff": 0.0, "order": 1, "kind": "low-pass", "factor": 1.0}
    numbers = {"mass": mass, "handStiffness": stiffness, "period": period, "delay": delay}
    setup = numbers | zeros | {"estimator": estimator}
    main = loop_of(setup).region().main
    assert main is not None
    (answer,) = asked_of_node("regions", [setup])
    assert answer["hasMain"]
    assert answer["farthest"][0][0][0] == pytest.approx(main.stiffest.stiffness, rel=1e-5)


@needs_node
def test_no_wall_is_called_the_stiffest_that_is_not_known_to_be_stable() -> None:
    """This filter's poles are so close to 1 that rounding moves them; it said 131,400 N/m."""
    velocity = {"cutoff": 4.4750145222014535, "order": 7}
    controller = {"sample_time": 0.0008049738999438972, "delay_samples": 1e-9}
    device = {"mass": 0.9650713766628134, "damping": 52.60650239882647}
    table = {"device": device, "controller": controller | {"velocity": velocity}}
    state = initial_of(page_of(table))["state"]
    (words,) = asked_of_node("headlines", [state | {"estimator": state | {"numerator": None}}])
    found = re.search(r"([\d,.]+) N/m, at a damping of ([\d,.]+) N", words)
    if found is None:
        assert words == "The stable region was not resolved here; jaxstab limits knows more."
        return
    wall = (float(number.replace(",", "")) for number in found.groups())
    assert scene_loop(Scene.from_table(table)).verdict(*wall) == jaxstab.Verdict.STABLE


@needs_node
def test_an_estimator_by_its_coefficients_has_its_own_region() -> None:
    table = {"velocity": {"preset": "hapkit"}, "sample_time": 1e-4}
    scene = Scene.from_table({"device": {"mass": 0.1, "damping": 1.0}, "controller": table})
    state = initial_of(explorer_page(scene))["state"]
    (answer,) = asked_of_node("regions", [state | {"estimator": state}])
    limits = scene_loop(scene).limits()
    assert answer["farthest"][0][0] == pytest.approx([limits.stiffness, limits.at_damping])


@pytest.mark.campaign
@needs_node
def test_margins_and_settling_times_of_walls(rng: np.random.Generator) -> None:
    found = setups_with_walls(rng, 2, 20)
    answers = asked_of_node("walls", [setup for _, setup, *_ in found])
    compared = 0
    for (loop, _, stiffness, damping), answer in zip(found, answers, strict=True):
        margins = loop.margins(stiffness, damping)
        settling = loop.settling_time(stiffness, damping, horizon=1 << 15)
        for index, wall in enumerate(answer):
            if wall["settling"] is None or not np.isfinite(settling.value[index]):
                continue
            compared += 1
            assert wall["settling"] == pytest.approx(
                settling.value[index], abs=1e-3 * loop.sample_time
            )
            for name in ("stiffness", "damping"):
                known = getattr(margins, name)[index]
                assert wall[name] == pytest.approx(known, abs=1e-5 * np.ptp(known))
            if wall["extraDelay"] is not None:
                known = margins.extra_delay[index]
                assert wall["extraDelay"] == pytest.approx(known, abs=1e-4 * loop.sample_time)
    assert compared > 3


def random_contacts(rng: np.random.Generator, count: int) -> list[Any]:
    """Loops with a wall and with conditions of a contact: half of the walls are stable."""
    found = []
    while len(found) < count:
        setup = random_setup(rng)
        loop = loop_of(setup)
        limits = loop.limits()
        if not np.isfinite(limits.stiffness):
            continue
        share = rng.uniform(0.1, 2.0)
        wall = {"stiffness": share * limits.stiffness, "damping": share * limits.at_damping}
        push = float(10.0 ** rng.uniform(-1.0, 1.0))
        friction = push * float(rng.choice([0.0, rng.uniform(0.01, 0.8)]))
        depth = push / wall["stiffness"]
        conditions = {
            "push": push,
            "friction": friction,
            "staticFriction": friction * float(rng.choice([1.0, 1.3])),
            "encoder": depth * float(rng.choice([0.0, rng.uniform(0.01, 0.3)])),
            "speed": float(rng.choice([0.0, depth / setup["period"] / 100.0])),
            "oneSided": bool(rng.random() < 0.8),
        }
        found.append((loop, setup | {"wall": wall, "conditions": conditions}))
    return found


def contact_of(loop: Any, setup: Any, push: float) -> jaxstab.results.Contact:
    """The same contact from Python, with another push."""
    given, wall = setup["conditions"], setup["wall"]
    return jaxstab.contact(
        loop,
        wall["stiffness"],
        wall["damping"],
        push=push,
        friction=given["friction"],
        static_friction=given["staticFriction"],
        encoder=given["encoder"],
        speed=given["speed"],
        one_sided=given["oneSided"],
    )


def departure(first: np.ndarray, other: np.ndarray, share: float) -> int:
    """The first sample at which two motions differ by a share of the largest position."""
    count = min(first.size, other.size)
    differs = ~(np.abs(other[:count] - first[:count]) <= share * np.nanmax(np.abs(first)))
    return int(np.argmax(differs)) if np.any(differs) else count


def contact_without_friction(
    fields: dict[str, float], wall: tuple[float, float], conditions: dict[str, Any]
) -> tuple[jaxstab.HapticLoop, dict[str, Any]]:
    """A free kilogram and its wall, with a velocity over one sample."""
    zeros = dict.fromkeys(("handMass", "handStiffness", "handDamping", "delay", "damping"), 0.0)
    plain = {"window": 1, "cutoff": 0.0, "order": 1, "kind": "low-pass", "factor": 1.0}
    setup: dict[str, Any] = {"mass": 1.0, "estimator": plain} | zeros | fields
    still = dict.fromkeys(("push", "friction", "staticFriction", "encoder", "speed"), 0.0)
    setup["conditions"] = still | conditions
    setup["wall"] = dict(zip(("stiffness", "damping"), wall, strict=True))
    return loop_of(setup), setup


def slow_contact() -> tuple[jaxstab.HapticLoop, dict[str, Any]]:
    """A contact that still moves in the end, less and less, as no random one does."""
    fields = {"damping": 1.5, "period": 1e-3}
    return contact_without_friction(fields, (100.0, 0.0), {"push": 1.0, "oneSided": False})


@needs_node
def test_an_encoder_rounds_exact_ties_to_the_even_step_as_python_does() -> None:
    """Half a step per sample, all in powers of two; the wall's first force comes after ten."""
    period, step = 2.0**-10, 2.0**-17
    loop, setup = contact_without_friction(
        {"period": period, "delay": 10.0}, (4096.0, 16.0),
        {"encoder": step, "speed": 0.5 * step / period, "oneSided": True},
    )  # fmt: skip
    known = contact_of(loop, setup, 0.0).path
    assert known is not None
    assert np.array_equal(known.position[:11], 0.5 * step * np.arange(11))
    read = step * np.array([0, 0, 1, 2, 2, 2, 3, 4, 4, 4, 5])  # 0, 1/2, 1, 3/2 ... steps
    speed = np.diff(read, prepend=0.0) / period
    force = -np.maximum(4096.0 * read + 16.0 * speed, 0.0)
    assert np.array_equal(known.force[:11], np.where(read > 0.0, force, 0.0))
    (answer,) = asked_of_node("contacts", [setup])
    assert np.allclose(answer["positions"][:40], known.position[:40], rtol=1e-13, atol=0.0)


@needs_node
@pytest.mark.campaign
def test_contacts_are_those_of_python(rng: np.random.Generator) -> None:
    """To 1e-9 of the largest position; chaotic ones until Python's own roundings part them."""
    away = {"speed": 0.1, "encoder": 1e-4, "oneSided": True}  # it is thrown off, and never pushed
    leaving = contact_without_friction({"damping": 1.5, "period": 1e-3}, (1000.0, 2.0), away)
    found = [*random_contacts(rng, many(30, 16)), slow_contact(), leaving]
    answers = asked_of_node("contacts", [setup for _, setup in found])
    kinds, chaotic = set(), 0
    for (loop, setup), answer in zip(found, answers, strict=True):
        push = setup["conditions"]["push"]
        known = contact_of(loop, setup, push)
        assert known.path is not None
        kind = jaxstab.results.ContactKind(int(known.kind)).name.lower()
        kinds.add(kind)
        assert answer["kind"] == kind, setup
        positions, expected = np.array(answer["positions"]), known.path.position
        same = departure(expected, positions, 1e-9)
        if same < positions.size:  # then the last digit of the push matters as much
            chaotic += 1
            pushes = push * (1.0 + 2.0**-52 * np.array([-2, -1, 1, 2]))
            paths = [contact_of(loop, setup, float(one)).path for one in pushes]
            parted = min(departure(expected, path.position, 1e-12) for path in paths if path)
            assert parted <= same, setup
            continue
        size = np.nanmax(np.abs(expected))
        for name, measure, scale in (
            ("amplitude", known.amplitude, size),
            ("frequency", known.frequency, known.frequency),
            ("timeToRest", known.time_to_rest, known.time_to_rest),
        ):
            if np.isfinite(measure):
                assert abs(answer[name] - measure) <= 1e-9 * scale, (name, setup)
            else:
                assert answer[name] is None
    assert {"rests", "bounces", "grows", "decays", "outside"} <= kinds
    assert chaotic < 6


@needs_node
def test_passive_walls_are_those_of_python(rng: np.random.Generator) -> None:
    plain = {"window": 1, "cutoff": 0.0, "order": 1, "kind": "low-pass", "factor": 1.0}
    setups = [random_setup(rng) | {"damping": 0.5, "estimator": plain} for _ in range(8)]
    for setup, outline in zip(setups, asked_of_node("passives", setups), strict=True):
        loop = loop_of(setup)
        alpha, beta = loop.alpha(1.0), loop.beta(1.0)
        own = setup["damping"] * float(beta)
        region = jaxstab.paper.passive_region(delta=own, delay=setup["delay"])
        points = np.array(outline[:-1]) * [alpha, beta]
        assert np.all(region.contains(*(0.995 * points).T))
        assert not np.any(region.contains(*(1.005 * points).T))


@needs_node
def test_the_linear_rule_is_that_of_python(rng: np.random.Generator) -> None:
    setups = [random_setup(rng) for _ in range(20)]
    for setup, line in zip(setups, asked_of_node("rules", setups), strict=True):
        loop = loop_of(setup)
        for stiffness, damping in line:
            limit = jaxstab.paper.linear_alpha_limit(
                loop.beta(damping), delta=loop.delta, delay=loop.delay_samples
            )
            size = abs(loop.delta) + loop.beta(abs(damping))
            assert abs(limit - loop.alpha(stiffness)) <= 1e-12 * size


CONTACTS: list[dict[str, Any]] = [
    {
        "device": {"mass": 0.1, "damping": 1.0, "friction": 0.3, "encoder": {"resolution": 2e-5}},
        "contact": {"push": 2.5},
    },
    {"device": {"inertia": 1e-3, "damping": 1e-3, "friction": 1e-3}, "contact": {"push": 0.02}},
    {"device": {"mass": 0.1, "damping": 1.0, "encoder": {"resolution": 1e-7}}},
]


def test_a_page_begins_with_the_contact_of_the_scene() -> None:
    keys = ("contact", "friction", "push", "speed", "encoder")
    states = [initial_of(page_of(table))["state"] for table in CONTACTS]
    assert [[state[key] for key in keys] for state in states] == [
        ["on", 0.3, 2.5, 0.1, 2e-5],
        ["on", 1e-3, 0.02, 1.0, 0.0],
        ["off", 0.0, 1.0, 0.1, 1e-7],
    ]


def test_a_page_says_what_its_simulated_contacts_ignore() -> None:
    contact = {"push": 1.0, "duration": 2.0, "one_sided": False}
    notes = " ".join(initial_of(page_of({"contact": contact}))["notes"])
    assert "ignore contact.one_sided, contact.duration of the scene" in notes
    notes = " ".join(initial_of(page_of({"contact": {"gate": "force"}}))["notes"])
    assert "ignore contact.gate of the scene" in notes
    assert "ignore" not in " ".join(initial_of(page_of(CONTACTS[0]))["notes"])


@pytest.mark.campaign
@needs_node
def test_a_page_shows_the_worst_of_the_starts_as_a_scene_does() -> None:
    """Pushed from rest all of these come to rest; at a speed one bounces, one stays outside."""
    starts = [(0.1, 1.0, 0.1), (0.02, 0.05, 0.3), (0.3, 1.0, 0.0)]
    tables = [dict(zip(("friction", "push", "speed"), start, strict=True)) for start in starts]
    wall = {"stiffness": 3000.0, "damping": 2.0}
    setups, worst = [], []
    for table in tables:
        scene = Scene.from_table(
            {
                "device": {"mass": 0.25, "damping": 0.1, "friction": table["friction"]},
                "controller": {"sample_time": 1e-3, "delay": 1e-3},
                "walls": {"own": wall},
                "contact": {key: table[key] for key in ("push", "speed")},
            }
        )
        state = initial_of(explorer_page(scene))["state"]
        conditions = {key: state[key] for key in ("friction", "push", "encoder", "speed")}
        setups.append(state | {"estimator": state, "wall": wall, "conditions": conditions})
        worst.append(simulate_contacts(scene).walls["own"])
    for answer, known, table in zip(
        asked_of_node("worstContacts", setups), worst, tables, strict=True
    ):
        assert answer["kind"] == known.contact.name.lower()
        assert (answer["speed"] > 0.0) == known.worst_start.startswith("at ")
        assert answer["speed"] in (0.0, table["speed"])
    assert {known.contact.name for known in worst} == {"BOUNCES", "OUTSIDE", "RESTS"}


@needs_node
def test_contacts_that_cannot_be_simulated_are_refused_in_a_sentence() -> None:
    state = initial_of(page_of({}))["state"]
    setup = state | {"estimator": state, "wall": {"stiffness": 100.0, "damping": 1.0}}
    conditions = {"friction": 0.1, "push": 1.0, "encoder": 0.0}
    cases = [
        setup | {"conditions": conditions},
        setup | {"conditions": conditions | {"push": 0.0}},
        setup | {"conditions": conditions, "period": 1.0},
        setup | {"conditions": conditions, "period": 1e-6},
        setup | {"conditions": conditions, "damping": 1e4},
        setup | {"conditions": conditions, "wall": {"stiffness": 0.0, "damping": 1.0}},
    ]
    words = ["", "a push", "too long for a contact", "in a browser", "too fast", "nothing holds"]
    for answer, expected in zip(asked_of_node("refusals", cases), words, strict=True):
        assert expected in answer
        assert bool(answer) == bool(expected)


@needs_node
def test_a_link_reproduces_the_state_and_a_scene_is_one(rng: np.random.Generator) -> None:
    states = [initial_of(explorer_page(Scene.from_file(path)))["state"] for path in SCENES]
    table = {"velocity": {"preset": "hapkit"}, "sample_time": 1e-4}
    states.append(initial_of(page_of({"controller": table}))["state"])
    states += [initial_of(page_of(table))["state"] for table in CONTACTS]
    words = {"stiffness": 1.5, "damping": -2.0, "name": 'a "b" & c=d #é'}
    states[0]["walls"].append(words)
    assert asked_of_node("links", states) == states
    del states[0]["walls"][-1]
    for state, text in zip(states, asked_of_node("scenes", states), strict=True):
        scene = Scene.from_table(tomllib.loads(text))
        again = initial_of(explorer_page(scene))["state"]
        assert again == state


@needs_node
def test_a_scene_takes_the_walls_of_any_link() -> None:
    state = initial_of(page_of({}))["state"]
    texts = [f"a{chr(k)}b" for k in (*range(0x370), *range(0x2000, 0x2070), 0xD800, 0xE000, 0xFEFF)]
    texts += ["", "-1", "=1+1", "\x7fa", "\u202eb", "z\U0001f600" * 60, "a" * 63 + "\U0001f600b"]
    walls = [{"name": text, "stiffness": 1.0, "damping": 2.0} for text in texts]
    (linked,) = asked_of_node("links", [state | {"walls": walls}])
    (text,) = asked_of_node("scenes", [linked])
    names = Scene.from_table(tomllib.loads(text)).walls
    assert len(names) > 700
    assert {"aéb", "ab", "1", "wall", "z\U0001f600" * 32, "a" * 63 + "\U0001f600"} <= {*names}


@pytest.mark.campaign
@needs_node
def test_a_link_keeps_long_windows_and_high_orders() -> None:
    """A shorter window or a lower order is another estimator, which allows stiffer walls."""
    walls = {f"{'a' * 63}{end}": {"stiffness": 1.0, "damping": 1.0} for end in "bc"}
    other = initial_of(page_of({}))["state"]
    for velocity, window, order in (
        ({"window_samples": 200}, 200, None),
        ({"cutoff": 400.0, "order": 12, "kind": "butterworth"}, 1, 12),
    ):
        table = {"controller": {"sample_time": 1e-4, "delay": 2e-2, "velocity": velocity}}
        state = initial_of(page_of(table | {"walls": walls}))["state"]
        assert (state["window"], state["delay"]) == (window, 200.0)
        assert order in (None, state["order"])
        assert asked_of_node("links", [other, state])[1] == state
    beyond = state | {"window": 201, "delay": 201.0, "numerator": [1.0, -1.0]}  # half a filter
    unchanged = {key: other[key] for key in ("window", "delay", "numerator", "denominator")}
    (_, taken) = asked_of_node("links", [other, beyond])
    assert {key: taken[key] for key in unchanged} == unchanged


@needs_node
def test_the_scene_has_the_cut_off_that_the_page_computes_with() -> None:
    velocity = {"cutoff": 400.0, "order": 2, "kind": "butterworth"}
    controller = {"sample_time": 1e-3, "velocity": velocity}
    state = initial_of(page_of({"controller": controller}))["state"] | {"period": 5e-3}
    (text,) = asked_of_node("scenes", [state])
    assert tomllib.loads(text)["controller"]["velocity"]["cutoff"] == pytest.approx(99.8)
    Scene.from_table(tomllib.loads(text))


# --------------------------------------------------------------------------- in a real browser


@pytest.fixture(scope="module")
def page() -> Iterator[Browser]:
    if MISSING:
        pytest.skip(MISSING)
    with browser() as opened:
        yield opened


@pytest.fixture
def omega(page: Browser, tmp_path: Path) -> Browser:
    file = tmp_path / "walls.html"
    file.write_text(explorer_page(Scene.from_file(SCENES[0].parent / "omega.toml")), "utf-8")
    page.look("light", 1360, 1000)
    page.complaints()
    page.open(file.as_uri())
    return page


def axe() -> Path:
    """The script of axe-core."""
    if OWN_AXE:
        return Path(OWN_AXE)
    (folder,) = find_spec("axe_core_python").submodule_search_locations
    return Path(folder) / "axe.min.js"


def answer_of(page: Browser, question: str, cases: Any) -> Any:
    return page.run(f"{ANSWERS}\nreturn {question}(arguments[0]);", cases)


@pytest.mark.campaign
def test_points_of_the_curve_in_a_browser(omega: Browser, rng: np.random.Generator) -> None:
    count = 0
    while count < POINTS:
        cases = curve_cases(rng, 100, 40)
        count += assert_curves_are_true(cases, answer_of(omega, "curves", cases))


@pytest.mark.campaign
def test_verdicts_in_a_browser(omega: Browser, rng: np.random.Generator) -> None:
    count = 0
    while count < POINTS:
        found = setups_with_walls(rng, 5, 1000)
        answers = answer_of(omega, "verdicts", [setup for _, setup, *_ in found])
        count += assert_verdicts_are_right(found, answers)[0]


@pytest.mark.campaign
def test_many_regions_in_a_browser(omega: Browser, rng: np.random.Generator) -> None:
    count = POINTS // 1000
    setups = [random_setup(rng) for _ in range(count)]
    unresolved = assert_regions_are_right(setups, answer_of(omega, "regions", setups))
    assert unresolved <= max(1, count // 40)


@pytest.mark.campaign
def test_the_console_stays_empty_and_nothing_is_fetched(omega: Browser) -> None:
    omega.run(MOVE_ALL)
    fetched = omega.run("return performance.getEntriesByType('resource').map((one) => one.name);")
    assert [name for name in fetched if not name.startswith("data:")] == []
    assert omega.complaints() == []


MOVE_ALL = """
for (const slider of document.querySelectorAll("input[type=range]")) {
  const before = slider.value;
  for (const place of [0, 90, 200, 310, 400, before]) {
    slider.value = place;
    slider.dispatchEvent(new Event("input", { bubbles: true }));
  }
}
sayMore();
"""


@pytest.mark.campaign
def test_links_of_any_kind_are_drawn_or_refused(omega: Browser, rng: np.random.Generator) -> None:
    states = [hostile_state(rng) for _ in range(POINTS // 250)]
    drawn = omega.run(TAKE_OVER, states)
    assert sum(drawn) > len(states) // 3  # the others are not resolved, or refused
    assert omega.complaints() == []


TAKE_OVER = """
return arguments[0].map((change) => {
  const link = hashOf({ ...initial.state, ...change });
  update(stateOfHash(link, initial.state));
  sayMore();
  return drawn.region.isClosed;
});
"""
MOVE = """
const slider = document.getElementById(arguments[0]);
slider.value = arguments[1];
slider.dispatchEvent(new Event("input", { bubbles: true }));
document.body.getBoundingClientRect();
clearTimeout(waiting); // what comes after a pause
"""


@pytest.mark.campaign
def test_a_slider_is_followed_by_its_picture(omega: Browser) -> None:
    """How much time of its processor the page takes for one move; nothing is asserted of it."""
    time.sleep(1.0)  # for the pictures by which the page warms up
    omega.devtools("Performance.enable", {"timeDomain": "threadTicks"})
    sliders = (
        "return Array.from(document.querySelectorAll('#controls input[type=range]'), (s) => s.id)"
    )
    times = []
    for slider in omega.run(sliders):
        for place in range(0, 401, 20):
            before = busy(omega)
            omega.run(MOVE, slider, place)
            times.append(1e3 * (busy(omega) - before))
    middle, slow, slowest = np.quantile(times, (0.5, 0.99, 1.0))
    words = f"{middle:.1f} ms in the middle, {slow:.1f} for 99 %, {slowest:.1f} at most\n"
    sys.stdout.write(words)  # -s shows it
    assert len(times) == 9 * 21
    assert omega.complaints() == []


@pytest.mark.campaign
def test_what_a_move_leaves_open_is_resolved_when_the_slider_rests(omega: Browser) -> None:
    rough, left = omega.run(RESTS)
    assert rough > 0
    assert left == 0


RESTS = """
let rough = 0, left = 0;
for (const slider of document.querySelectorAll("#controls input[type=range]")) {
  for (let place = 0; place <= 400; place += 20) {
    slider.value = place;
    slider.dispatchEvent(new Event("input", { bubbles: true }));
    rough += drawn.isRough;
    const { loop } = drawn;
    sayMore();
    left += drawn.isRough || drawn.region.isClosed !== regionOf(loop).isClosed;
  }
}
return [rough, left];
"""


def busy(page: Browser) -> float:
    """For how many seconds the page's own thread has worked, the driver's share with it."""
    metrics = page.devtools("Performance.getMetrics", {})["metrics"]
    return next(float(one["value"]) for one in metrics if one["name"] == "TaskDuration")


@pytest.mark.campaign
def test_sliders_move_by_keys_and_the_link_brings_the_state_back(omega: Browser) -> None:
    omega.run("document.getElementById('window-slider').focus();")
    before = omega.run("return document.getElementById('headline').textContent;")
    omega.press("\ue012" * 60)  # arrow to the left
    after = omega.run("sayMore(); return document.getElementById('headline').textContent;")
    assert before != after
    address = omega.run("return location.href;")
    assert "#mass=" in address
    omega.open("about:blank")
    omega.open(address)
    assert omega.run("return document.getElementById('headline').textContent;") == after


@pytest.mark.campaign
def test_the_choice_of_software_names_the_estimator_that_is_computed(omega: Browser) -> None:
    """Of 20 ms at 1 kHz, and after each of these changes."""
    for change, words in (
        ("", "force-dimension-sdk"),
        ("changeTo('period', 1e-4);", "as set below"),  # then its 20 samples are 2 ms
        (SDK, "force-dimension-sdk"),  # 200 samples
        ("changeTo('window', 1);", "the difference over one sample, as in the paper"),
        ("changeTo('period', 5e-5);", "the difference over one sample, as in the paper"),
        (SDK, "the difference over one sample, as in the paper"),  # 400 samples are too many
    ):
        omega.run(f"{change} sayMore();")
        assert omega.run(CHOSEN) == words
    refusal = omega.run("return document.getElementById('refusal').textContent;")
    assert "the window of force-dimension-sdk in samples must be a number from 1 to 200" in refusal
    address = omega.run("return location.href;")
    omega.open("about:blank")
    omega.open(address)
    assert omega.run(CHOSEN) == "the difference over one sample, as in the paper"


CHOSEN = "return document.getElementById('software').selectedOptions[0].textContent;"
SDK = """
const choice = document.getElementById("software");
choice.value = Array.from(choice.options).find((one) => one.text === "force-dimension-sdk").value;
choice.dispatchEvent(new Event("change"));
"""


@pytest.mark.campaign
@pytest.mark.parametrize("size", [1e-8, 1e-3, 1e4])
def test_numbers_at_the_axes_are_whole(omega: Browser, tmp_path: Path, size: float) -> None:
    file = tmp_path / "size.html"
    file.write_text(page_of({"device": {"inertia": size, "damping": size}}), "utf-8")
    omega.open(file.as_uri())
    assert omega.run(LEFTMOST) >= 0.0


LEFTMOST = """
const left = document.getElementById("picture").getBoundingClientRect().left;
const numbers = Array.from(document.querySelectorAll("#picture text.quiet"));
return Math.min(...numbers.map((one) => one.getBoundingClientRect().left - left));
"""


@pytest.mark.campaign
def test_narrow_pages_show_the_first_slider_and_do_not_scroll_sideways(omega: Browser) -> None:
    try:
        for width, most in ((500, 460), (390, 480), (320, 520)):
            omega.look("light", width, 832)  # as high as the frame on the first page
            lowest, wide, hidden = omega.run(NARROW)
            assert lowest < most
            assert wide <= width
            assert not hidden  # a mark of a wall, by the small map
    finally:
        omega.look("light", 1360, 1000)


NARROW = """
document.documentElement.classList.add("framed");
return new Promise((done) => setTimeout(() => {
  const slider = document.querySelector("input[type=range]").getBoundingClientRect();
  const map = document.querySelector("#picture .back");
  const box = map && map.getBoundingClientRect();
  const marks = Array.from(document.querySelectorAll("#picture .wall-good, #picture .wall-bad"));
  const isHidden = (one) => {
    const { left, right, top, bottom } = one.getBoundingClientRect();
    return right > box.left && left < box.right && bottom > box.top && top < box.bottom;
  };
  document.documentElement.classList.remove("framed");
  done([slider.bottom, document.documentElement.scrollWidth, Boolean(box) && marks.some(isHidden)]);
}, 300));
"""


@pytest.mark.campaign
def test_values_that_are_refused_are_named_in_one_sentence(omega: Browser) -> None:
    for key, value, words in (
        ("handStiffness", 1e11, "the hand's stiffness k is too large for this mass and sampling"),
        ("damping", 1e9, "the damping b is too large for this mass and sampling period"),
        ("period", 1e-5, "the sampling period is below 1 µs"),
        ("mass", -1, "mass must be a number above 0 to 1e12"),
        ("window", 201, "window must be a number from 1 to 200"),
        ("delay", 201, "delay must be a number from 0 to 200"),
        ("mass", 0.25, ""),
    ):
        refusal, kept = omega.run(GIVE, key, value)
        assert refusal.startswith(f"Not applied: {words}" if words else "")
        assert refusal.endswith("; the last values that work are kept." if words else "")
        assert refusal.count(".") <= 1 or "T²/m" in refusal
        assert kept == 0.25


GIVE = """
const number = document.getElementById(`${arguments[0]}-number`);
number.value = arguments[1];
number.dispatchEvent(new Event("change"));
return [document.getElementById("refusal").textContent, state.mass];
"""


@pytest.mark.campaign
def test_the_headline_is_a_stable_wall(omega: Browser, rng: np.random.Generator) -> None:
    for _ in range(20):
        mass, damping = 10.0 ** rng.uniform(-1.5, 0.5), 10.0 ** rng.uniform(-1.0, 1.0)
        delay, window = float(rng.uniform(0.0, 3.0)), int(rng.integers(1, 21))
        given = {"mass": mass, "damping": damping, "delay": delay, "window": window}
        headline = omega.run(f"update({json.dumps(given)}); sayMore(); {HEADLINE}")
        found = re.findall(r"[\d,.]+ (?=N)", headline)
        stiffness, of_wall = (float(number.replace(",", "")) for number in found)
        loop = jaxstab.HapticLoop(
            device_mass=mass,
            device_damping=damping,
            sample_time=1e-3,
            delay=1e-3 * delay,
            velocity=jaxstab.Velocity.difference(samples=window),
        )
        assert loop.verdict(stiffness, of_wall) == jaxstab.Verdict.STABLE
        assert stiffness == pytest.approx(loop.limits().stiffness, rel=2e-3)


HEADLINE = "return document.getElementById('headline').textContent;"


@pytest.mark.campaign
def test_a_contact_is_simulated_where_the_switch_is_on(omega: Browser) -> None:
    """The words are those of Python for the same wall, and never call it proved."""
    loop = scene_loop(Scene.from_file(SCENES[0].parent / "omega.toml"))
    contact = jaxstab.contact(loop, 1000.0, 8.0, friction=0.3, push=1.0)
    still = "friction: 0.3, push: 1, speed: 0"
    omega.run(f"update({{ cursorStiffness: 1000, cursorDamping: 8, {still} }});")
    off, on = omega.run(SWITCH)
    assert off["words"] == ""
    assert "as a share of its final value" in off["caption"]
    assert on["words"] == f"simulated: rests after {float(f'{contact.time_to_rest:.3g}'):g} s"
    assert "proved" not in on["words"] + on["caption"]
    assert on["scene"].count("friction = 0.3") == on["scene"].count("[contact]") == 1
    assert on["drawn"] != off["drawn"]
    assert omega.run(SWITCH) == [on, off]
    assert omega.complaints() == []


SWITCH = """
const text = (id) => document.getElementById(id).textContent;
const shown = () => {
  sayMore();
  return {
    words: text("contact-verdict"), caption: text("response-caption"), scene: text("scene"),
    drawn: document.getElementById("response").innerHTML,
  };
};
const before = shown();
document.getElementById("contact-on").click();
return [before, shown()];
"""


@pytest.mark.campaign
@pytest.mark.parametrize("contact", ["off", "on"])
@pytest.mark.parametrize("look", ["light", "dark"])
@pytest.mark.parametrize("width", [1360, 390])
def test_axe_finds_nothing(omega: Browser, look: str, width: int, contact: str) -> None:
    omega.look(look, width, 1000)
    omega.run("update({ contact: arguments[0], friction: 0.3 }); sayMore();", contact)
    omega.run("return new Promise((done) => setTimeout(done, 300));")  # it is drawn anew
    omega.run(axe().read_text(encoding="utf-8"))
    found = omega.run("return axe.run().then(({ violations }) => violations);")
    assert [(one["id"], one["nodes"][0]["html"]) for one in found] == []
