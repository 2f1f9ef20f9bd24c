"""`clothrf bench paper`: the paper's claims as measurements, on data that nobody trained on.

Read `study.py` for what is asked, `stages.py` for what is done, `results.py` for what came out.
"""
