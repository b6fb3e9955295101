"""Other people's methods, from their papers, on our photos, renderer, coding and evaluator."""
