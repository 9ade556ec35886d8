"""The proof: effects are concealed in recordings, sealed, diagnosed and counted."""
