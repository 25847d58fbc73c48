from setuptools import find_packages, setup

setup(
    name="nmt_bench",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"], "nmt_bench": ["page/static/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_bench"]),
        ("share/nmt_bench", ["package.xml"]),
        ("share/nmt_bench/launch", ["launch/bench.launch.py"]),
    ],
    install_requires=[
        "aiohttp>=3.9",
        "jinja2>=3.1",
        "numpy>=1.26",
        "rich>=13.7",
        "shtab>=1.6",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="Command line, harness of the node processes, live page, orchestration",
    license="Apache-2.0",
    entry_points={"console_scripts": ["nmt = nmt_bench.cli:program"]},
)
