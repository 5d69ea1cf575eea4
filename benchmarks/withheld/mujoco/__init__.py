"""Withheld cases on MuJoCo's physics: a plant, an integrator and a friction that others wrote.

python -m benchmarks.withheld.mujoco.run --first 100 --count 1
"""
