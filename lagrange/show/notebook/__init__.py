"""Output in notebooks: pages of systems and results, tables with pictures, progress, and sliders."""
