from setuptools import find_packages, setup

setup(
    name="nmt_signals",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_signals"]),
        ("share/nmt_signals", ["package.xml"]),
    ],
    install_requires=[
        "numpy>=1.26",
        "scipy>=1.11",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="Harmonics, frequency responses, decays and faults of channels: arrays in, numbers out",
    license="Apache-2.0",
    entry_points={"console_scripts": []},
)
