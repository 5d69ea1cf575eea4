"""Withheld effects: does the diagnosis name what is there, and keep silent when nothing is?"""
