"""The experiments of the paper's Sec. 3: recordings, refits, Table 3 and Figs. 10–15."""
