"""The languages and formats of `system.export`, one module for each. `lagrange/export/target.py` lists them."""
