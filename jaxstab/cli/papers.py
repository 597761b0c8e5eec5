"""The command that holds published numbers against jaxstab's."""

import click


@click.command()
@click.option("--markdown", "as_table", is_flag=True, help="Print a table in Markdown.")
def papers(as_table: bool) -> None:
    """Compute what was published about such loops, and print both numbers."""
    from jaxstab.papers import CLAIMS, markdown

    if as_table:
        click.echo(markdown(CLAIMS))
        return
    for claim in CLAIMS:
        found = claim.find()
        click.echo(f"{claim.source}: {claim.says}")
        click.echo(f"  printed  {claim.printed}")
        click.echo(f"  jaxstab  {found.answer}")
        click.echo(f"  {claim.words(found)}, difference {found.difference}")
