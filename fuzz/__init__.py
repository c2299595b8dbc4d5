"""Damaged files for every reader of structid: what is neither read nor refused in words is a defect.

python -m fuzz                      2000 mutants, the table
python -m fuzz --count 20000 --seed 5 --workers 2
python -m fuzz --only records/mat --keep failures
"""
