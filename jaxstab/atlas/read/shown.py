"""How an atlas shows itself: six lines of words, and a picture."""

from typing import TYPE_CHECKING, Any

from jaxstab.shown import table_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class ShownAtlas:
    """An atlas that shows itself."""

    def __repr__(self) -> str:
        """Return what the atlas holds: products, filters and axes, in six lines."""
        atlas: Any = self
        delays = ", ".join(f"{delay:g}" for delay in atlas.delays)
        first, last = atlas.nodes(0), atlas.nodes(len(atlas.delays) - 1)
        ends = {
            name: (f"{axis.size} nodes", f"{axis[0]:.4g} to {axis[-1]:.4g}")
            for name, axis in first.items()
        }
        later = [f"{axis[0]:.4g} to {axis[-1]:.4g}" for axis in list(last.values())[:2]]
        one_plane = len(atlas.delays) == 1
        rows = [
            (f"  {name}", *ends[name], "" if one_plane else f"at the last delay {span}")
            for name, span in zip(("alpha", "beta"), later, strict=True)
        ]
        hand = ", ".join(f"{name} {' '.join(ends[name])}" for name in ("gamma", "delta"))
        return "\n".join(
            [
                f"Atlas of {', '.join(atlas.products)}, made by {atlas.created_by}",
                f"  {atlas.filters_in_words}",
                f"  delays {delays} samples",
                table_text(rows),
                f"  {hand}",
            ]
        )

    def _repr_html_(self) -> str:
        """Return a picture of the first delay, and the words, for a notebook."""
        from jaxstab.pictures.atlas import atlas_html

        return atlas_html(self)  # type: ignore[arg-type]

    def plot(
        self,
        ax: "Axes | None" = None,
        *,
        gamma: float | None = None,
        delta: float | None = None,
        delay: float | None = None,
    ) -> "Axes":
        """Draw the verdicts of one plane of alpha and beta: stable, unstable, undecided.

        Args:
            ax: the axes of matplotlib to draw in; None makes a figure with matplotlib.pyplot.
            gamma: physical stiffness k T^2/m of the plane; None for the node in the middle.
            delta: physical damping b T/m of the plane; None for the node in the middle.
            delay: a delay of the atlas, in samples; None for its first one.

        Returns:
            The axes.

        Raises:
            ValueError: gamma or delta is outside of the atlas, the delay is none of its own, or it
                answers with no verdicts.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> axes = atlas.plot(delay=1.0)
        """
        from jaxstab.pictures.atlas import plot_atlas

        return plot_atlas(self, ax, gamma, delta, delay)  # type: ignore[arg-type]
