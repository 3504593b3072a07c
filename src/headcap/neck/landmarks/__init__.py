"""From sparse landmarks to coefficients: a tracked face drives the neck."""
