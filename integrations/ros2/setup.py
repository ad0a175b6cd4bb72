"""The package of the node, for colcon."""

from setuptools import setup

setup(
    name="touchfield_ros",
    version="1.0.0",
    packages=["touchfield_ros"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/touchfield_ros"]),
        ("share/touchfield_ros", ["package.xml"]),
    ],
    install_requires=["touchfield"],
    entry_points={
        "console_scripts": ["play = touchfield_ros.node:main", "press = touchfield_ros.press:main"]
    },
)
