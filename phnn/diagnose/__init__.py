"""Diagnosis of a fitted base model: score, refit, weigh and locate what it leaves out."""
