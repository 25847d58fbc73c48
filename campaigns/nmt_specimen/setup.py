from setuptools import find_packages, setup

setup(
    name="nmt_specimen",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_specimen"]),
        ("share/nmt_specimen", ["package.xml"]),
    ],
    install_requires=[
        "grpcio>=1.49",
        "JACK-Client>=0.5.4",
        "nidaqmx>=1.0",
        "numpy>=1.26",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="The simulated rig behind a converter's ports: stand-ins of sound card and NI device server",
    license="Apache-2.0",
    entry_points={"nmt.commands": ["specimen = nmt_specimen.specimen_command"]},
)
