from setuptools import find_packages, setup

setup(
    name="nmt_rig",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed", "rigs/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_rig"]),
        ("share/nmt_rig", ["package.xml"]),
    ],
    install_requires=[
        "numpy>=1.26",
        "pydantic>=2.5",
        "ruamel.yaml>=0.17.21",
        "scipy>=1.11",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="A rig as a file and as equations: rig files, structures, time integration, harmonic balance",
    license="Apache-2.0",
)
