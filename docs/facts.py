"""Where the numbers in the sentences of the pages come from.

A number in a sentence of README.md, docs/, data/README.md or CONTRIBUTING.md stands in a phrase of
``facts``, which takes it from a record in benchmarks/results, from a constant of the package or
from an answer of jaxstab; or in a phrase of STATED, which others measured or which defines a word
or a run; or it is of one of the KINDS, which say nothing that was measured. All other numbers are
``unknown``: they get a record, or leave the page. Tables that scripts write stand between marks,
and the tests run what is code. Of numbers in words, multiples are looked for.

`python -m docs.facts` prints the phrases that a page lacks, and the unknown numbers.
"""

import csv
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from math import asin, ceil, degrees, erf, sqrt
from pathlib import Path

import numpy as np

from benchmarks import measured, record, table
from benchmarks.rivals import MISSED, SHARES
from docs.pushed import Pushed
from docs.reproduced.claims import CLAIMS
from jaxstab import AtlasSpec, HandRange, HapticLoop, Velocity
from jaxstab.app.explore import explorer_page
from jaxstab.app.scene import any_scene
from jaxstab.app.scene.scene import presets
from jaxstab.atlas.file import SCHEMA_VERSION
from jaxstab.atlas.table import CLEAR
from jaxstab.boxes.search import PULLS
from jaxstab.loop.many import _DEGREES, _FEWEST
from jaxstab.model.device.parts import MOST_BITS
from jaxstab.model.filters import HIGHEST_ORDER, LONGEST_WINDOW
from jaxstab.model.plant import LONGEST_DELAY

ROOT = Path(__file__).parents[1]
PAGES = (
    *("README.md", "CONTRIBUTING.md", "data/README.md"),
    *(page.relative_to(ROOT).as_posix() for page in sorted((ROOT / "docs").rglob("*.md"))),
)
# Numbers of lemmas are derived there, and have tests: only what was measured needs a record.
MATHEMATICS = "docs/proofs.md"

# A number, and several in one list or range.
_ONE = r"(?<![\w.^])\d+(?:,\d{3})*(?:\.\d+)?(?:e[-+]?\d+)?(?![\d^])"
_SOME = rf"{_ONE}(?:(?:,| to| and|, and| or| x) {_ONE})*"

_DEFINITION = "of a definition: settling to 2 % (or 5 %), percentiles, errors of the linear rule"

# What is counted or measured is never of a harmless kind, in a lemma neither.
COSTS = re.compile(
    rf"{_SOME} ?(?:%|[kMG]i?B\b|lines\b|[num]?s of CPU|CPU)"
    rf"|\b(?:takes?|took) (?:about |at most |up to )?{_SOME} ?[num]?s\b"
)
IN_WORDS = re.compile(
    r"\b(?:two|three|four|five|six|seven|eight|nine|ten|twenty|fifty|hundred|thousand) times\b"
    r"|\ba (?:third|fifth|tenth|twentieth|thirtieth|hundredth|thousandth) of the\b"
)
COUNTS = re.compile(rf"{_SOME} times\b|(?<![\w.])\d{{1,3}}(?:,\d{{3}})+")
KINDS = {
    "a name, a version, a date or a citation": (
        r"\b[A-Za-z]\w*-\d[\d.]*|\b\d+(?:\.\d+){2,}|\b(?:19|20)\d\d(?:-\d\d-\d\d)?\b|\bdoi \S+"
        r"|\b(?:Python|HDF5|SPEC|version)\b(?: to| and|,| v?\d[\d.]*)+"
        r"|\b[Ee]qs?\. \(\d+\)(?:(?:,| to| and) \(\d+\))*|\bfigures \d+ to \d+|\b\d+\(\d+\)"
    ),
    "of a heading or an item": r"(?m)^(?:#+ )?\d+\. ",
    "a rate, a window, a delay, a degree or a precision: the case that a sentence is about": (
        rf"{_SOME} ?(?:k?Hz|(?:whole )?samples?\b|-?(?:significant )?digits?\b|bits\b)"
        rf"|\b(?:windows?|delays?|degrees?|orders?) (?:of |at )?{_SOME}(?: m?s\b)?"
        rf"|{_SOME} ms (?:window|delay|of delay)"
    ),
    "what a tolerance is": r"\b(?:within|to|than) 1e-\d+",
    _DEFINITION: (
        r"\b(?:within|to) 2 % \(or 5 %\)|\b(?:within|to) 2 %|\b5, 50 and 95 %|\b2 or 5 %"
        r"|\b5th (?:to|and) (?:the )?95th"
    ),
    "none, one or two": r"(?<![\w.^,])[0-2](?![\w.,]*\d)",
}

# Others measured these, or they define a word, a rule of the house, or what was run.
STATED = {
    "CONTRIBUTING.md": ["up to 1,000 lines"],
    "docs/commands.md": ["| 130 | Ended"],
    "docs/contact.md": [
        "1 N (0.05 N m)",
        "(0.02 to 2 kg, 0.01 to 3 N s/m, encoders of 1 to 50 µm,",
        "windows of 1, 5 and 20 samples, 0 or 1 ms of delay) with 40 walls each",
        *("of 8 s, with pushes that press 1 to 1,000 steps deep", "need more than 8 s"),
    ],
    "docs/explorer.md": ["for 4 s, pushed from"],
    "docs/frequency.md": ["1.3 to 2 is usual"],
    "docs/identify.md": [
        *("three times the friction", "kp that is ten times too large"),
        "10 to 60 s, 2,000 to 64,000 rows",
        "equal steps to within 10 %",
        "in 16 to 64 segments",
        "If more than 5 % stays",
    ],
    "docs/measured.md": [
        *("searched up to 10 N m/deg", "1.8 N m/deg with the difference and 5.4 with FOAW"),
        *("0.07 N m/deg with a period of 23 ms, and 0.01345 with 45 ms", "sampling at 350 us"),
        "would be 0.07 and not 1.8 N m/deg; 1.8 with a period of 23 ms",
        *("1.0 to 1.2 mN m in motion and 1.5 to 1.8 mN m at rest", "a push of 0.05 N m"),
        *("less than 1e-4 rad", "0.325 N/mm at 250 Hz, and 0.904 N/mm at 40 kHz"),
        *("180, 60 and 30 are quoted in theory, and 90 to 190 in", "quiet at up to 190"),
        "(0.1 kg, 1.5 N s/m, no delay), and of a device of 0.1 kg",
        *("in theory | not known | 6 : 2 : 1", "| 0.5, 1.5, 2.5 |", "| 0, 1, 2.5 |"),
    ],
    "docs/paper.md": ["about a thousand times a second"],
    "docs/recipes/chai3d.md": ["the same over 30 ms"],
    "docs/recipes/openhaptics.md": ["1 N/mm is 1,000 N/m, and 0.001 N s/mm"],
    "docs/robots.md": ["up to 1 % of the growth"],
    "docs/studies.md": ["median of 2,000 hands"],
    "docs/usable.md": ["a lag of nearly 180 degrees"],
    "docs/which.md": ["a phase margin of 30 degrees"],
}

_OMEGA = {"device_mass": 0.25, "device_damping": 0.1, "sample_time": 1e-3, "delay": 1e-3}
_ON_WINDOW = HapticLoop(**_OMEGA, velocity=Velocity.difference(window=0.02))


def facts() -> dict[str, list[str]]:
    """The phrases of each page, numbers included."""
    plain = int(HapticLoop(**_OMEGA).limits().stiffness)
    windowed = int(_ON_WINDOW.limits().stiffness)
    maker = presets("devices")["omega"]
    stiffest = f"{maker['largest_stiffness']['value']:,.0f} N/m"
    return {
        "README.md": [
            f"would hold {plain:,} N/m, with 20 ms it holds {windowed:,} N/m",
        ],
        "data/README.md": [
            f"{_measured_points()} measured limits",
            f"| `jaxstab atlas`, {SCHEMA_VERSION} |",
            _clear("`beta_error`"),
            _clear("`alpha_error`"),
            f"of {_resolution_walls()}",
            _worst_ratio("the error of its cell"),
        ],
        "docs/accuracy.md": [
            _clear("the measured error"),
            _default_nodes(),
            _resolution_walls(),
            _worst_ratio("that error"),
            *_rivals(),
            *_polynomials(),
            *_regions(),
            *_jitter(),
        ],
        "docs/contact.md": [*_contact()],
        "docs/explorer.md": [f"about {round(_page_size() / 1e4) * 10} kB"],
        "docs/faq.md": [
            f"lists {stiffest}",
            f"{windowed:,} N/m is the stable limit",
            f"would be {plain:,} N/m",
            f"period ({0.5 / 60.0:.4f} s)",
        ],
        "docs/frequency.md": [f"{MOST_BITS:,} bits"],
        "docs/gains.md": [f"{1e4 * 4e-3:.0f} N s/m here"],
        "docs/guide.md": [f"{_for_all_hands():,} N/m is proved", _pulls()],
        "docs/identify.md": [_log(), f"a mass of {0.25 * 1e6:,.0f} kg (time in ms)"],
        "docs/measured.md": [*_measured()],
        "docs/model.md": [
            f"up to {LONGEST_DELAY:g} samples",
            f"up to {LONGEST_WINDOW} samples and {HIGHEST_ORDER} poles each",
            f"conservative by at most {100.0 - _least_share():.1f} % of the stiffness",
        ],
        "docs/paper.md": [
            f"{_OMEGA['device_mass']} kg with {_OMEGA['device_damping']} N s/m at 1 kHz",
            f"{plain:,} N/m with the one-sample difference, and {windowed:,} N/m",
            f"by a factor of {plain // windowed}.",
            *_paper(),
        ],
        "docs/quickstart.md": [
            f"one sample {plain:,} N/m is stable",
            f"software {windowed:,} N/m:",
        ],
        "docs/recipes/chai3d.md": [
            _less_stiff(0.015, plain),
            f"they are {stiffest} and {maker['largest_damping']['value']:g} N s/m",
        ],
        "docs/robots.md": [*_robots()],
        "docs/studies.md": [
            f"{erf(sqrt(0.5)):.0%} are between 200 and {300 * 1.5:g}".replace("%", " %"),
        ],
        "docs/usable.md": [
            f"a phase margin of {degrees(2.0 * asin(0.25)):.0f} degrees",  # of |S| <= 2
            f"{_OMEGA['device_mass']} kg, {_OMEGA['device_damping']} N s/m, 1 kHz",
            "velocity over 20 ms",
            _only_pushing(),
        ],
        "docs/transforms.md": [
            f"at least {_FEWEST[_DEGREES[0]]} loops ({_FEWEST[41]} above degree {_DEGREES[3]}, "
            f"{_FEWEST[65]} above {_DEGREES[4]})"
        ],
    }


def _rivals() -> Iterator[str]:
    yield f"within more than {100.0 * MISSED:g} %."
    yield f"asked at {max(SHARES):.0e} to {min(map(abs, SHARES)):.0e}".replace("e-0", "e-")
    scipy = max(row["largest_error_found"] for row in _tool("scipy brentq"))
    yield f"exact enough**: {int(-np.log10(scipy))} digits"
    starts = [_tool(name)[0]["first_seconds"] for name in ("numpy.roots, bisection", "jaxstab")]
    yield f"starts in {starts[0] / starts[1]:.0%} of the time".replace("%", " %")
    yield "A grid of ten times as many points a side"
    coarse, fine = (_tool(f"grid of {n} x {n}, contourpy") for n in (16, 160))
    times = [b["cpu_seconds"] / a["cpu_seconds"] for a, b in zip(coarse, fine, strict=True)]
    yield f"costs about {float(f'{np.exp(np.mean(np.log(times))):.1g}'):g} times the time"


def _polynomials() -> Iterator[str]:
    found = {(row["section"], row["method"]): row for row in _rows("polynomials")}
    names = [f"degree {degree}, clustered" for degree in (10, 40)]
    off = [found[name, "numpy.roots"]["error"] for name in names]
    assert off[1] > 1.0
    yield f"off by {off[0]:.1%} at degree 10".replace("%", " %")
    schur = [found[name, "jaxstab.is_schur"] for name in names]
    low, high = (100.0 * row["open"] / row["points"] for row in schur)
    yield f"leaves {low:.2f} to {high:.2f} % undecided"
    balls = [found[name, "jaxstab.radius, balls"]["cpu_seconds_per_point"] for name in names]
    yield f"in balls, in {1e3 * balls[0]:.1f} to {1e3 * balls[1]:.1f} ms."


def _regions() -> Iterator[str]:
    rows = [row for row in _rows("loops") if row["method"] != "numpy eigvals"]
    assert not _sum(rows, "wrong")
    regions = [row for row in rows if row["method"] == "stable_region"]
    yield f"regions of {_sum(regions, 'repeats'):,} random loops"
    kinds = ("walls", "radii", "points")
    walls, radii, points = (
        _sum([row for row in rows if row["section"].startswith(kind)], "judged") for kind in kinds
    )
    yield f"for {walls:,} walls, {radii:,} radii and {points:,} points of regions"
    asked = _rows("resolution")[0]["points"]
    yield f"{asked:,} random walls"
    for section, words in {"verdict": "of {} verdicts", "spectral_radius": "{} radii on"}.items():
        points = max(row["points"] for row in _accelerated(section))
        yield words.format(f"{points:.0e}".replace("e+0", "e"))


def _accelerated(section: str) -> list[record.Row]:
    (one,) = (one for one in _records() if one["benchmark"] == "accelerator")
    return [row for row in one["rows"] if row["section"] == section and row["method"] != "2 cores"]


def _jitter() -> Iterator[str]:
    counts = _rows("jitter")[0]
    grown = ("STABLE that grow", "UNSTABLE that decay", "constant, differ")
    assert not any(counts.get(name) for name in grown)
    yield (
        f"In {counts['loops']} loops, {counts['STABLE']} walls were proved stable and attacked for "
        f"{counts['samples'] / 1e6:.1f} million samples: none grew. "
        f"All {counts['sequences that grow']} sequences for unstable walls grew. "
        f"For {counts['constant']:,} walls with a range of a single delay"
    )
    yield f"omega-like ({_OMEGA['device_mass']} kg, {_OMEGA['device_damping']} N s/m, 1 kHz)"
    yield f"at {table.DAMPINGS[0]} and {table.DAMPINGS[2]:g} times that"


def _least_share() -> float:
    """The least stiffness that is proved up to the damping of the stiffest wall, in percent."""
    rows = [row for row in _rows("jitter")[1:] if row["proved"] and row["factor"] <= 1.0]
    return min(100.0 * row["proved"] / row["grows"] for row in rows)


def _contact() -> Iterator[str]:
    counts = _rows("contact")[0]
    assert not counts["above"]
    yield f"drew {counts['devices']} devices"
    yield f"Of {counts['bounded']:,} two-sided contacts"
    yield f"came to {counts['largest_share_of_bound']:.0%} of its bound"
    yield f"Of {counts['runs']:,} one-sided contacts of 2 s"
    ratios = sum(counts[f"ratios {held}{counted}"] for held in (0, 1) for counted in (0, 1))
    yield f"{ratios:,} one-sided contacts"


def _for_all_hands() -> int:
    """The stiffness for all hands of the guide's scene."""
    hands = HandRange(mass=(0.0, 0.5), stiffness=(0.0, 300.0), damping=(0.0, 5.0))
    return int(_ON_WINDOW.robust_limit(hands).stiffness)


def _default_nodes() -> str:
    spec = AtlasSpec()
    counts = spec.rows, *(len(nodes) for nodes in spec.nodes)
    return f"by default with {' x '.join(map(str, counts))} nodes"


def _resolution_walls() -> str:
    return f"{_rows('resolution')[0]['points']:,} random walls"


def _worst_ratio(error: str) -> str:
    """How far a limit was wrong at most, rounded up, of the errors that a cubic's cells state."""
    worst = max(row["ratio"] for row in _rows("resolution") if row["method"] == "cubic")
    return f"{ceil(10.0 * worst) / 10.0:g} times {error}"


def _clear(error: str) -> str:
    return f"{ {4.0: 'four'}[CLEAR] } times {error}"


def _less_stiff(window: float, plain: int) -> str:
    loop = HapticLoop(**_OMEGA, velocity=Velocity.difference(window=window))
    assert loop.limits().stiffness < 0.1 * plain
    return f"a window of {1e3 * window:g} ms the omega-like device keeps less than a tenth of the"


def _only_pushing() -> str:
    held = replace(_ON_WINDOW, hand_stiffness=1e-6)
    limits = held.limits()
    proved = held.one_sided_limit(ratio=limits.at_damping / limits.stiffness)
    return f"is proved up to {int(proved.stiffness):,} N/m"


def _pulls() -> str:
    least, most = (f"{100.0 * pull:g} %" for pull in (PULLS[0], PULLS[-1]))
    return f"a wall {least} below the stiffest that was found, or up to {most}"


def _measured() -> Iterator[str]:
    rows = _rows("measured")
    yield f"{_measured_points()} points,"
    for gain, period in ((0.07, 23e-3), (0.01345, 45e-3), (1.8, 23e-3)):
        inertia = gain * np.rad2deg(1.0) * (period / (2.0 * np.pi)) ** 2
        yield f"{inertia:.1e} kg m^2"
    preset, *_ = [row for row in rows if row["section"] == "rate"]
    for column, words in (("limits", "of {:.0f};"), ("measured", "only {:.1f}.")):
        low, high = map(float, preset[column].split())
        yield words.format(high / low)
    linear = [float(row["paddle"].split()[0]) for row in rows if row["section"] == "linear"]
    yield f"a factor of more than {max(linear) / min(linear) // 10 * 10:.0f} in inertia"
    free = {"device_mass": 1.0, "device_damping": 0.0, "sample_time": 1.0}
    delays = 0.5, 1.5, 2.5
    best = [HapticLoop(**free, delay=delay).limits().stiffness for delay in delays]
    yield " : ".join(f"{stiffness / best[2]:.3g}" for stiffness in best)
    slow = [1.0 / (0.5 + delay) for delay in (0.0, 1.0, 2.5)]
    yield " : ".join(f"{stiffness / slow[2]:.3g}" for stiffness in slow)


def _paper() -> Iterator[str]:
    stress = [row for row in _rows("stress") if row["section"] == "delay"]
    exact, roots = (
        [row for row in stress if row["method"] == name]
        for name in ("verdict, exact", "numpy.roots")
    )
    assert not _sum(exact, "wrong")
    yield (
        f"In {_sum(exact, 'points'):,} random and adversarial loops no verdict was wrong and "
        f"{_sum(exact, 'undecided')} were undecided; "
        f"`numpy.roots` was wrong in {_sum(roots, 'wrong'):,}."
    )
    (speed,) = (
        row["cpu_times_numpy_eigvals"]
        for row in _rows("throughput")
        if (row["section"], row["method"], row["delay"]) == ("delay", "verdict", 1.0)
    )
    yield f"It is still {speed:.0f} times faster than LAPACK eigenvalues for a million walls"
    read = [one for one in CLAIMS if not (one.is_misprint or one.source.startswith("later"))]
    yield f"agrees with {len(read)} published claims"


def _robots() -> Iterator[str]:
    rows = _rows("robots")
    gains = f"kp = {rows[0]['kp']:g} N m/rad (N/m) and kd = {rows[0]['kd']:g}"
    yield gains
    yield gains.replace("kp", "Kp").replace(" N m/rad (N/m)", "")
    yield f"need up to {max(row['missing_armature'] for row in rows):.2g} kg m²"


def _log() -> str:
    log = Pushed()
    return (
        f"with {log.mass} kg, {log.damping} N s/m, {log.friction} N of friction, a delay of "
        f"{1e3 * log.delay:g} ms and an encoder of {1e6 * log.encoder:g} um"
    )


def _measured_points() -> int:
    with Path(measured.DATA).open(encoding="utf-8") as lines:
        return sum(1 for _ in csv.DictReader(lines))


def _page_size() -> int:
    text = (ROOT / "data" / "scenes" / "omega.toml").read_text(encoding="utf-8")
    return len(explorer_page(any_scene(tomllib.loads(text))).encode())


@cache
def _records() -> list[record.Record]:
    return record.read_all(record.RESULTS)


def _rows(benchmark: str) -> list[record.Row]:
    rows: list[record.Row] = table.of_one_machine(_records())[benchmark]["rows"]
    return rows


def _tool(name: str) -> list[record.Row]:
    return [row for row in _rows("rivals") if row["method"] == name]


def _sum(rows: list[record.Row], column: str) -> int:
    return sum(row[column] for row in rows)


def sentences(text: str) -> str:
    """A page without its code, its formulas, its links' targets and the tables of scripts."""
    text = re.sub(r"(?s)\A---\n.*?\n---\n", "", text)
    text = re.sub(r"(?ms)^( *)```.*?^\1```", "", text)
    text = re.sub(r"(?s)<!-- ([^\n]*?) begin -->.*?<!-- \1 end -->", "", text)
    text = re.sub(r"<!-- printed by the lines above -->\n(?:\|.*\n)+", "", text)
    text = re.sub(r"(?s)<!--.*?-->|<[a-z/][^>]*>", "", text)
    text = re.sub(r"(?m)^(?: {4}.*\n)+", "", text)
    text = re.sub(r"`[^`]*`|\$[^$\n]*\$|--8<--.*", "", text)
    text = re.sub(r"\]\([^)\s]*\)|https?://\S+", "]", text)
    return re.sub(r"\n *(?![\s#|]|\d+\. )", " ", text)  # lines of a paragraph


def missing(text: str, phrases: list[str]) -> list[str]:
    """The phrases that a page does not have; where it breaks lines does not matter."""
    return [phrase for phrase in phrases if not re.search(_wrapped(phrase), text)]


def _wrapped(phrase: str) -> str:
    return r"\s+".join(map(re.escape, phrase.split()))


def unknown(text: str, phrases: list[str], *, is_mathematics: bool = False) -> list[str]:
    """The numbers of a page, with what stands around them, that come from nowhere."""
    shown = _shown(text)
    for phrase in phrases:
        text = re.sub(_wrapped(phrase), "", text)
    text = sentences(text)
    claims = [COSTS] if is_mathematics else [COSTS, COUNTS]
    claimed = [match.span() for claim in claims for match in claim.finditer(text)]
    harmless = [match.span() for kind in KINDS.values() for match in re.finditer(kind, text)]
    defined = [match.span() for match in re.finditer(KINDS[_DEFINITION], text)]
    found = []
    for match in re.finditer(_ONE, text):
        is_harmless = is_mathematics or _is_within(match.span(), harmless)
        is_harmless |= float(match[0].replace(",", "")) in shown
        is_claimed = _is_within(match.span(), claimed) and not _is_within(match.span(), defined)
        if is_claimed or not is_harmless:
            around = text[max(0, match.start() - 40) : match.end() + 40]
            found.append(f"{match[0]} in: {' '.join(around.split())}")
    if not is_mathematics:
        found += [f"{match[0]}, in words" for match in IN_WORDS.finditer(text)]
    return found


def _is_within(span: tuple[int, int], others: list[tuple[int, int]]) -> bool:
    return any(start <= span[0] and span[1] <= end for start, end in others)


def _shown(text: str) -> set[float]:
    """The numbers of a page's code and of what it prints, in s and in ms."""
    code = re.findall(r"(?ms)^( *)(```.*?)^\1```", text)
    code += re.findall(r"(<!-- printed by)( the lines above -->\n(?:\|.*\n)+)", text)
    values = {float(x.replace(",", "")) for _, lines in code for x in re.findall(_ONE, lines)}
    return {float(f"{value * unit:.12g}") for value in values for unit in (1.0, 1e3, 1e-3)}


def main() -> int:
    """Print what is not accounted for; the number of such places."""
    count, known = 0, facts()
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        phrases = known.get(page, []) + STATED.get(page, [])
        lines = [f"lacks: {phrase}" for phrase in missing(text, phrases)]
        lines += unknown(text, phrases, is_mathematics=page == MATHEMATICS)
        count += len(lines)
        for line in lines:
            print(f"{page}: {line}")
    return count


if __name__ == "__main__":
    sys.exit(min(main(), 1))
