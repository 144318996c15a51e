"""What people type: equations as in a notebook, in Unicode or LaTeX, read into the strict notation of scene files."""
