"""Reports for people: a discrepancy in words, figures and one page."""
