from setuptools import find_packages, setup

setup(
    name="nmt_robots",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_robots"]),
        ("share/nmt_robots", ["package.xml"]),
    ],
    install_requires=[
        "jinja2>=3.1",
        "matplotlib>=3.6",
        "mujoco>=3.3.7",
        "numpy>=1.26",
        "pydantic>=2.5",
        "scipy>=1.11",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="Robots as MJCF or URDF and logs of their joints: faults of the log, and each joint",
    license="Apache-2.0",
    entry_points={"console_scripts": []},
)
