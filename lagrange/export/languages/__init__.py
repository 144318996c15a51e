"""The targets of `System.export`: one module for each language. The table is in `target.py`."""
