"""Results for people: formulas, figures, animations, notebooks, cards, tables in a terminal, and files of runs."""
