"""Research beside the product: suites of experiments, baselines, rival policies."""
