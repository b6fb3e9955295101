"""Scripts behind the figures of docs/results, and checks too long for the tests."""
