"""What notebooks show: pages of systems and results, tables with pictures, progress, and sliders."""
