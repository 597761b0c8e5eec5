"""Render the conda recipe with rattler-build's own engine: what conda would build, and of what."""

from pathlib import Path

from rattler_build import Stage0Recipe, VariantConfig

recipe = Stage0Recipe.from_file(str(Path(__file__).with_name("conda") / "recipe.yaml"))
(package,) = recipe.render(VariantConfig())
print(f"conda recipe: {package}")
