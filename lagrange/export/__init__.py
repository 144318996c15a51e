"""Export models as source code in other languages, each with a self-test: `system.export` and its targets."""
