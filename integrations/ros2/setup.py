"""The package as colcon builds it."""

from setuptools import setup

NAME = "touchfield_ros2"

setup(
    name=NAME,
    version="0.1.0",
    description="Plays a .touch file: the force of a haptic medium at a hand, as wrenches",
    license="BSD-3-Clause",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools", "touchfield"],
    zip_safe=True,
    entry_points={"console_scripts": [f"player = {NAME}.player_node:main"]},
)
