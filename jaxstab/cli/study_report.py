"""What the command for studies prints, and the CSV file: tables, quantiles and shares."""

from collections.abc import Callable, Iterator, Mapping
from itertools import chain, product
from math import inf, prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from jaxstab.cli.options import draw, print_with_csv
from jaxstab.conventions import Verdict
from jaxstab.scene.study import lists_of, quantiles, shares
from jaxstab.shown import printable, table_text

if TYPE_CHECKING:
    from xarray import Dataset

_MOST_IN_CSV = 1_048_575  # rows, as in a spreadsheet, with one of names


def require_few(sizes: Mapping[Any, int], csv_file: Path | None) -> None:
    """Refuse to write a CSV file of more rows than a spreadsheet has; UsageError."""
    rows = prod(sizes.values())
    if csv_file and rows > _MOST_IN_CSV:
        raise click.UsageError(
            f"the CSV file would have {rows:,} rows; give --output in place of --csv for more than "
            f"{_MOST_IN_CSV:,}."
        )


def report(table: "Dataset", csv_file: Path | None, plot: Path | None) -> None:
    """Print the results of a study, and write its table and its picture."""
    is_grid = "sample" not in table.dims and prod(table.sizes.values()) <= _MOST_IN_CSV
    columns = _columns(table) if csv_file or is_grid else {}
    words = [*_limits_words(table), *_shares_words(table)]
    if is_grid:
        own = {name: values for name, values in columns.items() if not name.startswith("wall_")}
        words = [_table([[_head(table, name) for name in own], *_rows(own, _shown)]), *words]
    print_with_csv("\n".join(words), chain([columns], _rows(columns, _cell)), csv_file)
    if plot:
        from jaxstab.pictures.study import study_figure

        draw(study_figure(table), plot)


def _head(table: "Dataset", name: str) -> str:
    unit = table[name].attrs.get("units", "1")
    return name.replace("_", " ") + (f" ({unit})" if unit != "1" else "")


def _columns(table: "Dataset") -> dict[str, Any]:
    """Return what varies and the answers as columns of a row for each loop and wall."""
    words = {}
    for name, values in table.data_vars.items():
        if "flag_values" in values.attrs:
            names = np.array(values.attrs["flag_meanings"].split())
            codes = np.searchsorted(values.attrs["flag_values"], values)
            words[name] = values.copy(data=names[codes])
    order = [name for name in (*lists_of(table), "sample", "wall") if name in table.dims]
    frame = table.assign(words).to_dataframe(dim_order=order).reset_index()
    labels = [name for name in table.coords if name not in order]
    return {str(name): frame[name].to_numpy() for name in (*order, *labels, *table.data_vars)}


def _rows(columns: dict[str, Any], shown: Callable[[Any], str]) -> Iterator[list[str]]:
    for row in zip(*columns.values(), strict=True):
        yield [shown(value) for value in row]


def _cell(value: Any) -> str:
    """Return a cell of CSV, empty for NaN and infinite numbers."""
    return "" if value in (-inf, inf) or value != value else str(value)


def _shown(value: Any) -> str:
    return printable(value) if isinstance(value, str) else f"{value:.6g}"


def _limits_words(table: "Dataset") -> list[str]:
    """Return the quantiles of the largest stiffness among draws."""
    if "largest_stiffness" not in table or "sample" not in table.dims:
        return []
    found = quantiles(table).transpose(*lists_of(table), "quantile")
    unit = found.attrs["units"]
    heads = [*lists_of(table), f"largest stiffness in {unit}: 5th percentile", "median"]
    rows = [
        [*labels, *(f"{value:.5g}" for value in row)]
        for labels, row in zip(_points(table), found.values.reshape(-1, 3), strict=True)
    ]
    return [_table([[*heads, "95th percentile"], *rows])]


def _shares_words(table: "Dataset") -> list[str]:
    """Return for which share of the draws, or of the grid, each wall is stable."""
    if "verdict" not in table:
        return []
    names = [str(name) for name in table.wall.values]
    if "sample" not in table.dims:
        codes = table.verdict.transpose(..., "wall").values.reshape(-1, len(names))
        return [
            f"{name}: stable for {(column == Verdict.STABLE).sum():,} of {len(column):,} loops, "
            f"{(column == Verdict.UNDECIDED).sum():,} undecided"
            for name, column in zip(names, codes.T, strict=True)
        ]
    found, lists = shares(table).transpose(*lists_of(table), "wall"), lists_of(table)
    percent = 100.0 * found[["share", "low", "high"]].to_array().transpose(..., "variable")
    if not lists:
        return [
            f"{name}: stable for {share:.4g} % of {found.draws:,} draws (95 % confidence: "
            f"{low:.4g} to {high:.4g} %; each verdict proved, {undecided} undecided)"
            for name, (share, low, high), undecided in zip(
                names, percent.values, found.undecided.values, strict=True
            )
        ]
    rows = [
        [*labels, *(f"{share:.4g} ({low:.4g} to {high:.4g})" for share, low, high in row)]
        for labels, row in zip(
            _points(table), percent.values.reshape(-1, len(names), 3), strict=True
        )
    ]
    heads = [*lists, *(f"{name}: % stable" for name in names)]
    undecided = int(found.undecided.sum())
    words = f"in brackets: 95 % confidence; each verdict proved, {undecided} undecided"
    return [_table([heads, *rows]), words]


def _points(table: "Dataset") -> Iterator[list[str]]:
    """Return the values of the lists at each point of their grid, as text."""
    values = [
        [f"{v:g}" if along.dtype.kind in "fi" else printable(str(v)) for v in along.values]
        for along in (table[name] for name in lists_of(table))
    ]
    return map(list, product(*values))


def _table(rows: list[list[str]]) -> str:
    most_rows = 20  # that are printed
    more = len(rows) - 1 - most_rows
    text = table_text(rows[: 1 + most_rows])
    return f"{text}\n... and {more:,} more rows; write them with --csv or -o" if more > 0 else text
