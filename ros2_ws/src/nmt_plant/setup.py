from setuptools import find_packages, setup

setup(
    name="nmt_plant",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_plant"]),
        ("share/nmt_plant", ["package.xml"]),
    ],
    install_requires=[
        "grpcio>=1.49",
        "nidaqmx>=1.0",
        "numpy>=1.26",
        "scipy>=1.11",
        "sounddevice>=0.4.6",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="The rig as a device: contract, oscillator, output guard, watchdog, simulated rig; plant node",
    license="Apache-2.0",
    entry_points={
        "console_scripts": ["plant = nmt_plant.plant_node:main", "topic_bridge = nmt_plant.topic_bridge_node:main"]
    },
)
