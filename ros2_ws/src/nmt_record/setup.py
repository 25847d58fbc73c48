from setuptools import find_packages, setup

setup(
    name="nmt_record",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_record"]),
        ("share/nmt_record", ["package.xml"]),
    ],
    install_requires=[
        "h5py>=3.10",
        "lvm-read>=1.22",
        "lz4>=4.0",
        "mcap>=1.1",
        "npTDMS>=1.7",
        "numpy>=1.26",
        "pydantic>=2.5",
        "PyYAML>=6.0",
        "rosbags==0.11.9",
        "scipy>=1.11",
        "zstandard>=0.22",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="rosbag2 writer and reader of the bench; recorder node",
    license="Apache-2.0",
    entry_points={"console_scripts": ["recorder = nmt_record.bag.recorder_node:main"]},
)
