"""The proof: effects are concealed in recordings, sealed, diagnosed and counted.

    cases → sealed → diagnosed (score stage, or the whole command) → opened → graded → counted → shown

Recordings come from `studies.generator`, which shares no code with the models that explain them.
"""
