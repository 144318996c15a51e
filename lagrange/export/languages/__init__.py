"""The languages of exported code, one file each; `BUILT_IN` in `lagrange.export.target` lists them."""
