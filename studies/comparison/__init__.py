"""The comparison of all models on recordings that go beyond the identified range, and the rivals that join it."""
