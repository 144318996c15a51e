"""Reader of typed equations, plain, in Unicode or LaTeX, into the strict notation of scene files."""
