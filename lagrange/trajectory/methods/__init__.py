"""The integration methods: data and transformations, each with its claims."""
