"""The texts of each language: programs, helper functions and reserved words. `programs.py` reads them."""
