"""Draw pictures of README and of pages such as docs/frequency.md: python data/pictures/pages.py."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

import jaxstab
from jaxstab.app.scene import Scene, loop_of

matplotlib.use("Agg")
from matplotlib import pyplot

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
BLUE, ORANGE, GREY = "#0072b2", "#b35c00", "#4a5366"


def quickstart(loop: jaxstab.HapticLoop) -> None:
    """What loop.plot() draws."""
    figure, ax = pyplot.subplots(figsize=(7, 4.2), layout="constrained")
    loop.plot(ax=ax)
    figure.savefig(DOCS / "quickstart.png", dpi=130)


def frequency(loop: jaxstab.HapticLoop) -> None:
    """What loop.plot("nyquist", ...) and loop.plot("bode", ...) draw."""
    figure, (plane, magnitudes) = pyplot.subplots(1, 2, figsize=(10, 4), layout="constrained")
    loop.plot("nyquist", 1000.0, 12.0, ax=plane)
    loop.plot("bode", 1000.0, 12.0, ax=magnitudes)
    figure.savefig(DOCS / "frequency.png", dpi=110)


def stable_area(loop: jaxstab.HapticLoop) -> tuple[Any, np.ndarray, np.ndarray]:
    """The limits, and the largest stable stiffness at many dampings."""
    limits = loop.limits()
    damping = np.linspace(0.0, limits.damping, 400)
    return limits, damping, loop.stiffness_limits(damping)[:, 1]


def usable_area(loop: jaxstab.HapticLoop, **margins: float) -> tuple[Any, np.ndarray, list[float]]:
    """The limits with margins, and the largest usable stiffness at many dampings."""
    limits = loop.limits(**margins)
    rows = limits.second * np.linspace(0.0, 1.0, 81)[:-1]
    ends = [loop.intervals(damping=row, **margins).inner for row in rows.tolist()]
    return limits, rows, [max((high for _, high in row), default=0.0) for row in ends]


def window(loop: jaxstab.HapticLoop) -> None:
    """README's picture: stable walls with the velocity over one sample and over the window."""
    figure, ax = pyplot.subplots(figsize=(8, 3.8), layout="constrained")
    inset = ax.inset_axes([0.6, 0.44, 0.39, 0.5])
    inset.set_title("20 ms, enlarged", fontsize=9)
    inset.tick_params(labelsize=8)
    found = {}
    for name, own, colors in (
        ("one sample", replace(loop, velocity=jaxstab.Velocity()), ("#cfe6f5", "#8fc3e4")),
        ("20 ms", loop, ("#f6dcc2", "#dd9d63")),
    ):
        edge, damping, stiffness = stable_area(own)
        inside, rows, widest = usable_area(own, phase_margin=30)
        found[name] = edge.stiffness
        for axes in (ax, inset) if own is loop else (ax,):
            label = f"velocity over {name}: stable up to {int(edge.stiffness):,} N/m"
            axes.fill_betweenx(damping, 0.0, stiffness, color=colors[0], label=label)
            label = f"with 30 degrees of phase margin up to {int(inside.first):,} N/m"
            axes.fill_betweenx(rows, 0.0, widest, color=colors[1], label=label)
    share = found["20 ms"] / found["one sample"]
    ax.set_title(f"A velocity window of 20 ms leaves {share:.0%} of the stiffness", loc="left")
    ax.indicate_inset([0, 0, 2300, 55], inset, edgecolor=GREY)
    inset.set(xlim=(0, 2300), ylim=(0, 55))
    ax.set(xlim=(0, 66e3), ylim=(0, 330), xlabel="stiffness K (N/m)", ylabel="damping B (N s/m)")
    ax.set_xticks(range(0, 40_001, 10_000))
    ax.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    figure.savefig(DOCS / "window.png", dpi=120)


def usable(loop: jaxstab.HapticLoop) -> None:
    """Of one device: the edge of stability, walls with margins, and passive walls."""
    figure, ax = pyplot.subplots(figsize=(8, 5), layout="constrained")
    edge, damping, stiffness = stable_area(loop)
    label = f"stable: up to {int(edge.stiffness):,} N/m, no margin there"
    ax.fill_betweenx(damping, 0.0, stiffness, color="#cfe6f5", label=label)
    ax.plot(stiffness, damping, color=BLUE, linewidth=2)
    for margins, words, color in (
        ({"gain_margin": 2.0}, "K and B may double", "#9ccbe8"),
        ({"phase_margin": 20.0}, "20 degrees of phase margin", "#f6dcc2"),
        ({"sensitivity": 2.0}, "peak of |S| of 2 at most", "#b9dcb0"),
        ({"phase_margin": 45.0}, "45 degrees of phase margin", "#eec093"),
    ):
        best, rows, widest = usable_area(loop, **margins)
        label = f"{words}: up to {int(best.first):,} N/m"
        ax.fill_betweenx(rows, 0.0, widest, color=color, label=label)
    passive = loop.passive_region()
    inset = ax.inset_axes([0.73, 0.3, 0.25, 0.3])
    inset.fill(*passive.outline.T, color="#7d8a99")
    inset.set_title(f"passive: up to {int(passive.stiffest[0])} N/m", fontsize=8)
    inset.tick_params(labelsize=7)
    ax.legend(fontsize=8, frameon=False, loc="upper right")
    ax.set(xlim=(0, 3100), ylim=(0, 55), xlabel="stiffness K (N/m)", ylabel="damping B (N s/m)")
    figure.savefig(DOCS / "usable.png", dpi=130)


def which(loop: jaxstab.HapticLoop) -> None:
    """One wall of one stable set, and the methods that answer about it."""
    K, B = 1000.0, 25.0  # N/m, N s/m
    best, damping, stiffness = stable_area(loop)
    fastest, margins = loop.tune(), loop.margins(K, B)
    figure, ax = pyplot.subplots(figsize=(8, 5), layout="constrained")
    ax.fill_betweenx(damping, 0.0, stiffness, color="#cfe6f5")
    ax.plot(stiffness, damping, color=BLUE, linewidth=2)
    arrow = {"arrowstyle": "->", "color": ORANGE, "linewidth": 1.6}
    for end in ((K * float(margins.stiffness_gain), B), (K, B * float(margins.damping_gain))):
        ax.annotate("", end, (K, B), arrowprops=arrow)
    (right,) = loop.stiffness_limits([B])[:, 1]
    about_one = "one wall (K, B)\nverdict, amplitude,\nspectral_radius,\nsettling_time"
    for point, text, place in (
        ((K, B), about_one, (420, 25.5)),
        ((best.stiffness, best.at_damping), "largest stiffness\nlimits", (2100, 11.0)),
        ((best.at_stiffness, best.damping), "largest damping\nlimits", (80, 48.5)),
        ((right, B), "largest K at this B\nstiffness_limits", (right + 60, 25.5)),
        ((fastest.stiffness, fastest.damping), "settles fastest\ntune", (430, 9.5)),
    ):
        color = ORANGE if text == about_one else BLUE
        ax.plot(*point, "o", color=color, markersize=7, zorder=3, clip_on=False)
        ax.annotate(text, point, place, fontsize=10, color=GREY)
    ax.text(1180, 22.0, "margins", fontsize=10, color=ORANGE)
    ax.text(1150, 12.0, "all stable walls\nregion, plot", fontsize=10, color=BLUE)
    ax.set(xlim=(0, 2900), ylim=(0, 55), xlabel="stiffness K (N/m)", ylabel="damping B (N s/m)")
    figure.savefig(DOCS / "which.png", dpi=130)


def joints(scene: Scene) -> None:
    """Stable gains of the lightest and the heaviest joint, and the full scale of MIT frames."""
    lightest = loop_of(scene)
    kd = np.linspace(0.0, 6.0, 400)
    figure, ax = pyplot.subplots(figsize=(7, 4.2), layout="constrained")
    for inertia, color, name in zip(
        scene.device.effective_mass,
        ("#cfe6f5", "#f6dcc2"),
        ("motor alone", "with the arm"),
        strict=True,
    ):
        kp = replace(lightest, device_mass=inertia).stiffness_limits(kd)[:, 1]
        order = 2 if color == "#cfe6f5" else 1
        label = f"stable, {name}: {inertia:g} kg m²"
        ax.fill_betweenx(kd, 0.0, np.nan_to_num(kp), color=color, zorder=order, label=label)
    ax.plot([500, 500, 0], [0, 5, 5], "--", color=GREY, zorder=3, label="full scale of MIT frames")
    for name, wall in scene.walls.items():
        point = wall.stiffness, wall.damping
        ax.plot(*point, "o", color=ORANGE, zorder=4)
        ax.annotate(name, point, (6, 5), textcoords="offset points", fontsize=10, zorder=4)
    ax.set(xlim=(0, 620), ylim=(0, 6), xlabel="kp (N m/rad)", ylabel="kd (N m s/rad)")
    figure.legend(loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    figure.savefig(DOCS / "joints.png", dpi=130)


if __name__ == "__main__":
    omega = jaxstab.HapticLoop(
        device_mass=0.25,
        device_damping=0.1,
        sample_time=1e-3,
        delay=1e-3,
        velocity=jaxstab.Velocity.difference(window=0.02),
    )
    quickstart(omega)
    frequency(omega)
    window(omega)
    usable(omega)
    which(omega)
    joints(Scene.from_file(ROOT / "data" / "scenes" / "joint.toml"))
