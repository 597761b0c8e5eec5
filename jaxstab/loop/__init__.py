"""A haptic loop in SI units, with its answers as methods: which engine gives which answer.

| answer | one loop | many loops, grids, derivatives |
|---|---|---|
| `verdict` | `exact.roots` (E1), in balls | `point.verdicts`: Schur and Cohn, with a bound |
| `spectral_radius`, `poles` | `exact.roots` (E2) | `point.radius`, `point.poles` |
| `intervals` | `exact.line` (E3) | loop by loop |
| `region`, `limits` | `region.region`, beside proved `exact.line` | `region.batch`, one program |
| `margins`, `frequency_margins` | `exact.margins` | loop by loop; derivatives: `loop.crossings` |
| `one_sided` | `exact.sector` (C7) | loop by loop |
| `settling_time`, `amplitude` | `exact.response` (E4) | loop by loop |
| `simulate` | `motion.response` | the same, with arrays |
| delays that move | `exact.margins` (J1), `exact.turns` (V10) | loop by loop |
| `worst_hand`, `robust_limit` | `boxes.search`: all hands of a range | loop by loop |
| `range_of` | `loop.backwards`: a scan, each end by E1 | loop by loop |
| `tune` | `tuning`, in float64; its radius by E2 | `loop.tune` |
| fields of an atlas | as one of many | `atlas.nodes` |
"""

from jaxstab.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
