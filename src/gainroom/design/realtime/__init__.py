"""While a controller runs: gains that go with posture and contact."""
