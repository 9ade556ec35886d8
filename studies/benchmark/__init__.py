"""A benchmark of diagnoses: sealed cases, answers of any tool, scores.

    drawn → made and sealed → answered by a tool → opened → scored → counted

A tool sees a folder of recordings and the inputs of further ones, its examination. It answers with probabilities of
what is missing, with the place, and with predictions of the examination.
"""
