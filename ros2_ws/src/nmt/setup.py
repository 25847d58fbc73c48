from setuptools import find_packages, setup

setup(
    name="nmt",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt"]),
        ("share/nmt", ["package.xml"]),
    ],
    install_requires=[
        "h5py>=3.10",
        "matplotlib>=3.6",
        "numpy>=1.26",
        "pandas>=2.0",
        "scipy>=1.11",
        "xarray>=2023.6",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="Results and functions for analysts: one import, no ROS",
    license="Apache-2.0",
)
