"""The explorer of the first page, made when the site is built (a hook of mkdocs)."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from jaxstab.app.explore import explorer_page
from jaxstab.app.scene import Scene


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add walls.html, which docs/index.md shows."""
    root = Path(config.config_file_path).parent
    scene = Scene.from_file(root / "data" / "scenes" / "omega.toml")
    files.append(File.generated(config, "walls.html", content=explorer_page(scene, "omega.toml")))
    return files
