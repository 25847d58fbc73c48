from setuptools import find_packages, setup

setup(
    name="nmt_core",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed", "*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_core"]),
        ("share/nmt_core", ["package.xml"]),
    ],
    install_requires=[
        "distributed>=2024.1",
        "h5py>=3.10",
        "joblib>=1.3",
        "numba>=0.59",
        "numpy>=1.26",
        "PyYAML>=6.0",
        "scipy>=1.11",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="Sample blocks, error type, ramps, parameter tables and the node base shared by the bench's nodes",
    license="Apache-2.0",
    entry_points={"console_scripts": []},
)
