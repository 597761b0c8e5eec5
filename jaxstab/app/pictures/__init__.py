"""Figures: regions, atlases, scenes, the paper's."""
