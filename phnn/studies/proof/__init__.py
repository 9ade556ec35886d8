"""The proof: effects are concealed in recordings, sealed, diagnosed and counted.

    cases → sealed → diagnosed (score stage, or the whole command) → opened → graded → counted → shown

Recordings come from `phnn.demo`, which shares no code with the models that explain them.
"""
