"""Steps of Taylor series: their size, their proof, their sum, and the loop over them."""
