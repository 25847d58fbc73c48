from setuptools import find_packages, setup

setup(
    name="nmt_blind",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"], "nmt_blind": ["cases/rigs/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_blind"]),
        ("share/nmt_blind", ["package.xml"]),
    ],
    install_requires=[
        "jinja2>=3.1",
        "matplotlib>=3.6",
        "numpy>=1.26",
        "PyYAML>=6.0",
        "rich>=13.7",
        "scipy>=1.11",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="The blind check of the diagnosis: sealed cases, campaigns, scores, baselines, calibration",
    license="Apache-2.0",
    entry_points={"nmt.commands": ["blind = nmt_blind.blind_command"]},
)
