"""Steps of Taylor series: their size, defect test and sum, and the loop over them."""
