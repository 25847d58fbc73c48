from setuptools import find_packages, setup

setup(
    name="nmt_diagnose",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_diagnose"]),
        ("share/nmt_diagnose", ["package.xml"]),
    ],
    install_requires=[
        "numpy>=1.26",
        "scipy>=1.11",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="The gap between a rig and its model: where it lies, which effect causes it, how far it shrinks",
    license="Apache-2.0",
)
