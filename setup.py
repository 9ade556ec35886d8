"""Packages of the distribution: those under phnn/, and configs/ as phnn.configs."""

from setuptools import find_packages, setup

setup(packages=[*find_packages(include=["phnn", "phnn.*"]), "phnn.configs"], package_dir={"phnn.configs": "configs"})
