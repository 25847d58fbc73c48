from setuptools import find_packages, setup

setup(
    name="nmt_benchmark",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_benchmark"]),
        ("share/nmt_benchmark", ["package.xml"]),
    ],
    install_requires=[
        "distributed>=2024.1",
        "numpy>=1.26",
        "rich>=13.7",
        "rosbags==0.11.9",
        "scipy>=1.11",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="Benchmarks: speed of this machine beside limits and peers, and trials of a failing output",
    license="Apache-2.0",
    entry_points={"nmt.commands": ["benchmark = nmt_benchmark.benchmark_command"]},
)
