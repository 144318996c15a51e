"""Reader of equations that people type, plain, in Unicode or LaTeX, into the strict notation of scene files."""
