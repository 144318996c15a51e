"""Words of expressions: letters of names, elementary functions, and the functions of texts."""
