"""FMUs: their descriptions in XML, and the C sources that every FMU contains."""
