"""Parts shared by the demo, guided captures and studies: processes, an operator, and comparisons with the truth."""
