"""What a command that computes with JAX sets for its process."""

from contextlib import suppress


def start_jax() -> None:
    """Switch on float64, and keep what is compiled for the next process of this user."""
    from jaxstab.batches import use_compilation_cache

    with suppress(OSError):  # without a cache it only takes longer
        use_compilation_cache()
    import jax

    jax.config.update("jax_enable_x64", True)
