"""Fields of atlases, against roots of 50 digits; plain readers draw them; one set of bytes."""

import math
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import flint
import h5py
import numpy as np
import pytest
from atlases import edited
from campaign import first
from matplotlib.figure import Figure
from mpmath import mp, mpc, mpf

import jaxstab
from jaxstab import AtlasSpec, FieldSpec, Velocity, build_atlas
from jaxstab.atlas.build import verify_atlas, write_atlas
from jaxstab.point.fields import UNKNOWN, _outwards, fields_of_grid, poles_outside
from jaxstab.results import Atlas
from tests.truth import filtered
from tests.truth import loop as truth

FIELDS = ("spectral_radius", "spectral_radius_error", "frequency", "damping_ratio", "outside")
DELAYS = [0.0, 0.3, 1.0, 2.0, 5.5, 12.0]
PLANTS = {"gamma": [0.0], "delta": [0.01], "delay": [0.0], "rows": 5}  # of the limits
WALLS = {"alpha": 24, "beta": 20}
SPEC = AtlasSpec(
    **PLANTS,
    fields=FieldSpec(**WALLS, gamma=[0.0, 0.001], delta=[0.0, 0.015], delay=DELAYS, where="all"),
)
NEAR = AtlasSpec(
    **PLANTS, fields=FieldSpec(**WALLS, gamma=[0.0005], delta=[0.0, 0.015], delay=[0.0, 1.0])
)


@pytest.fixture(scope="module")
def atlas(tmp_path_factory: pytest.TempPathFactory) -> Atlas:
    return build_atlas(SPEC, tmp_path_factory.mktemp("fields") / "all.h5")


@pytest.fixture(scope="module")
def near(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fields") / "near.h5"
    write_atlas(NEAR, path)
    return path


def is_right(roots: list[mpc], values: dict[str, float]) -> bool:
    """True if the fields of a node are those of its roots; unknown ones may be anything."""
    moduli = sorted((abs(root) for root in roots), reverse=True)
    upper, error = values["spectral_radius"], values["spectral_radius_error"]
    right = math.isnan(upper) or mpf(upper) - mpf(error) <= moduli[0] <= mpf(upper)
    outside = sum(modulus > 1 for modulus in moduli)
    close = any(abs(modulus - 1) < 1e-12 for modulus in moduli)
    right &= values["outside"] == outside or (close and values["outside"] == UNKNOWN)
    if not math.isnan(values["frequency"]):
        s = mp.log(max(roots, key=lambda root: (abs(root), root.imag)))
        right &= abs(abs(s.imag) - values["frequency"]) < 1e-6
        right &= abs(-s.real / abs(s) - values["damping_ratio"]) < 1e-6
    return bool(right)


@pytest.mark.parametrize("number", range(len(DELAYS)))
def test_fields_are_those_of_the_true_roots(
    atlas: Atlas, number: int, rng: np.random.Generator
) -> None:
    nodes, unresolved = [atlas.fields[name][:, number] for name in ("alpha", "beta")], 0
    nodes += [atlas.fields[name] for name in ("gamma", "delta")]
    arrays = {name: atlas.fields[name][..., number] for name in FIELDS}
    for _ in range(40):
        place = tuple(rng.integers(0, axis.size) for axis in nodes)
        point = [float(axis[i]) for axis, i in zip(nodes, place, strict=True)]
        values = {name: float(values[place]) for name, values in arrays.items()}
        assert values["spectral_radius_error"] < 3e-7 * values["spectral_radius"]
        assert is_right(truth.roots(*point, DELAYS[number]), values), (point, values)
        unresolved += math.isnan(values["frequency"])
    assert unresolved <= 2
    assert np.mean(arrays["outside"] == 0) > 0.3
    assert np.mean(arrays["outside"] == UNKNOWN) < 0.1


@pytest.mark.campaign
@pytest.mark.parametrize(("delay", "longest"), [(1.0, 1.0), (0.0, 2.5), (2.5, 30.0)])
def test_what_is_compiled_for_many_points_is_right_too(
    delay: float, longest: float, rng: np.random.Generator
) -> None:
    alpha, beta = np.linspace(-0.05, 0.3, 200), np.linspace(-0.2, 1.0, 180)
    hand = np.array([0.0005]), np.array([0.01])
    fast = fields_of_grid(alpha, beta, *hand, delay, None, longest=longest, method="fast")
    slow = fields_of_grid(alpha, beta, *hand, delay, None, longest=longest, method="companion")
    for i, j in zip(rng.integers(0, 200, 60), rng.integers(0, 180, 60), strict=True):
        roots = truth.roots(alpha[i], beta[j], 0.0005, 0.01, delay)
        for fields in (fast, slow):
            values = [float(column[i, j, 0]) for column in fields]
            assert is_right(roots, dict(zip(FIELDS, values, strict=True)))
    np.testing.assert_array_equal(fast.outside, slow.outside)
    assert np.nanmax(abs(fast.radius - slow.radius) - fast.error - slow.error) <= 0.0
    for one, other in ((fast.frequency, slow.frequency), (fast.damping_ratio, slow.damping_ratio)):
        assert np.mean(np.isnan(one) | np.isnan(other)) < 1e-3
        assert np.nanmax(abs(one - other)) < 2e-6
    for column in (*fast[:2], *slow[:2]):
        assert np.isfinite(column).all()


@pytest.mark.parametrize("count", first([1, 200], 1))
def test_fields_of_loops_with_an_estimator_are_right(count: int, rng: np.random.Generator) -> None:
    alpha, beta = np.linspace(0.0, 0.03, 200)[:: 200 // count], np.linspace(0.0, 0.2, 180)
    window, gamma, delta = Velocity.difference(samples=12), np.array([0.0005]), np.array([0.01])
    filters = jaxstab.AtlasSpec(velocity=window).filters
    fields = fields_of_grid(alpha, beta, gamma, delta, 1.0, filters, longest=1.0, method="fast")
    exact = filtered.FilteredLoop(0.0005, 0.01, 1.0, filtered.difference(12), filtered.average(1))
    balls = exact.balls(600)
    assert np.mean(fields.outside == 0) > 0.01
    for _ in range(40):
        i, j = int(rng.integers(0, alpha.size)), int(rng.integers(0, 180))
        coefficients = balls.polynomial(alpha[i], beta[j])
        with flint.ctx.workprec(600):
            found = truth.isolated_roots(coefficients, flint.arb(2) ** -200)
            assert found is not None
            roots = [mpc(truth.as_mpf(r.real.mid()), truth.as_mpf(r.imag.mid())) for r in found]
        values = [float(column[i, j, 0]) for column in fields]
        assert is_right(roots, dict(zip(FIELDS, values, strict=True)))


def test_a_double_or_triple_dominant_pole_is_bounded_but_not_resolved() -> None:
    root = 4.0 ** (1.0 / 3.0) - 1.0  # triple, at gamma = delta = delay = 0
    alpha, beta = np.array([6.0 * root**2 - 2.0]), np.array([2.0 * root**3])
    zero = np.zeros(1)
    fields = fields_of_grid(alpha, beta, zero, zero, 0.0, None, longest=0.0, method="fast")
    values = dict(zip(FIELDS, (float(column[0, 0, 0]) for column in fields), strict=True))
    assert is_right(truth.roots(alpha[0], beta[0], 0.0, 0.0, 0.0), values)
    assert values["spectral_radius_error"] < 1e-3
    assert math.isnan(values["frequency"])
    assert math.isnan(values["damping_ratio"])


@pytest.mark.parametrize("degree", [1, 2, 3, 5, 9, 10, 24])
def test_poles_outside_are_counted_for_any_polynomial(
    degree: int, rng: np.random.Generator
) -> None:
    polynomials = []
    for _ in range(200):
        pairs = rng.uniform(0.3, 1.7, degree // 2) * np.exp(1j * rng.uniform(0, 3, degree // 2))
        roots = np.concatenate([pairs, pairs.conj(), rng.uniform(-1.5, 1.5, degree % 2)])
        polynomials.append(np.poly(roots).real)
    columns = list(np.array(polynomials).T)
    counts = poles_outside(columns, np.full(200, 1e-15))
    for falling, count in zip(polynomials, counts, strict=True):
        found = flint.fmpq_poly([truth.as_fmpq(mpf(c)) for c in falling[::-1].tolist()])
        outside = sum(n for root, n in found.complex_roots() if abs(root) > 1)
        assert count in (outside, UNKNOWN)
    assert np.mean(counts == UNKNOWN) < (0.05 if degree < 20 else 0.15)
    np.testing.assert_array_equal(poles_outside(columns, np.full(200, 1e9)), UNKNOWN)


def test_values_and_bounds_are_rounded_outwards(rng: np.random.Generator) -> None:
    radius = np.concatenate([rng.uniform(0.0, 2.0, 2000), [0.5, 1.0, 1.0 - 2.0**-53, 1.0, 1.0]])
    bound = np.concatenate([10.0 ** rng.uniform(-15, 0, 2003), [np.inf, np.nan]])
    value, error = _outwards(radius, bound)
    for r, b, v, e in zip(*(c.tolist() for c in (radius, bound, value, error)), strict=True):
        if math.isfinite(b):
            exactly = [Fraction(number) for number in (r, b, v, e)]
            assert exactly[2] >= exactly[0] + exactly[1]
            assert exactly[2] - exactly[3] <= exactly[0] - exactly[1]
            assert e <= 8.0 * (b + 2.0**-23 * v)
        else:
            assert (math.isnan(v), e) == (True, math.inf)


def test_a_pole_on_the_circle_is_not_counted() -> None:
    columns = [np.ones(1), np.array([-1.5]), np.array([0.5])]  # roots 1 and 1/2
    assert poles_outside(columns, np.full(1, 1e-15)).tolist() == [UNKNOWN]


def test_near_nodes_are_the_corners_of_cells_with_a_stable_corner(near: Path, atlas: Atlas) -> None:
    with h5py.File(near) as whole:
        file = whole["fields"]
        outside, kept = file["outside"][()], ~np.isnan(file["spectral_radius"][()])
        expected = np.zeros_like(kept)
        for i, j, *hand in np.argwhere(outside == 0).tolist():
            plane = (slice(max(i - 1, 0), i + 2), slice(max(j - 1, 0), j + 2), *hand)
            expected[plane] = True
        np.testing.assert_array_equal(kept, expected)
        assert 0.3 < kept.mean() < 0.9
        for name in ("frequency", "damping_ratio", "spectral_radius_error"):
            assert np.isnan(file[name][()][~kept]).all()
    assert not np.isnan(atlas.fields["spectral_radius"]).any()


def test_three_lines_draw_a_heat_map_without_jaxstab(near: Path) -> None:
    xarray = pytest.importorskip("xarray")
    with h5py.File(near) as whole:
        file = whole["fields"]
        axes = Figure().subplots()
        alpha, beta = file["alpha"][:, 1], file["beta"][:, 1]
        mesh = axes.pcolormesh(beta, alpha, file["spectral_radius"][:, :, 0, 1, 1])
        assert 0.5 < np.nanmin(mesh.get_array()) < 1.0 < np.nanmax(mesh.get_array()) < 1.2
    with xarray.open_dataset(near, engine="h5netcdf", group="fields") as dataset:
        axes = Figure().subplots()
        plane = dataset.damping_ratio.sel(gamma=0.0005, delta=0.015, delay=1)
        drawn = plane.plot(x="alpha", y="beta", ax=axes)
        assert np.nanmax(drawn.get_array()) <= 1.0
        assert axes.get_xlabel().startswith("stiffness of the virtual wall")


def test_the_file_says_what_viewers_draw_and_which_array_bounds_which(near: Path) -> None:
    with h5py.File(near) as whole:
        file = whole["fields"]
        assert file.attrs["NX_class"] == b"NXdata"
        signal = file[file.attrs["signal"].decode()]
        axes = [name.decode() for name in file.attrs["axes"]]
        assert [file[name].shape[0] for name in axes] == list(signal.shape)
        assert all(name.decode() in file for name in file.attrs["auxiliary_signals"])
        bound = file[signal.attrs["ancillary_variables"].decode()]
        standard_name = signal.attrs["standard_name"].decode()
        assert bound.attrs["standard_name"].decode() == f"{standard_name} standard_error"
        assert file["frequency"].attrs["units"] == b"rad"
        assert signal.dtype == np.float32
        assert (signal.compression, signal.shuffle) == ("gzip", True)


def change(name: str, amount: float) -> Callable[[h5py.File], None]:
    def edit(file: h5py.File) -> None:
        values = file["fields"][name]
        values[...] = values[()] + np.array(amount, values.dtype)

    return edit


@pytest.mark.parametrize(
    ("name", "amount"),
    first(
        [
            ("spectral_radius", -1e-6),
            ("outside", 1),
            ("frequency", 1e-4),
            ("damping_ratio", -1e-4),
            ("spectral_radius", math.nan),
        ],
        2,
    ),
)
def test_verification_finds_wrong_fields(
    name: str, amount: float, near: Path, tmp_path: Path
) -> None:
    assert all(check.passed for check in verify_atlas(near, 300))
    path = edited(tmp_path / "wrong.h5", change(name, amount), near.read_bytes())
    checks: dict[str, Any] = {check.name: check.passed for check in verify_atlas(path, 300)}
    assert checks["fields"] is False
