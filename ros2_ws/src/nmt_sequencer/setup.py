from setuptools import find_packages, setup

setup(
    name="nmt_sequencer",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_sequencer"]),
        ("share/nmt_sequencer", ["package.xml"]),
    ],
    install_requires=[
        "numpy>=1.26",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="Level plans and the state machine of a test run; sequencer node",
    license="Apache-2.0",
    entry_points={"console_scripts": ["sequencer = nmt_sequencer.sequencer_node:main"]},
)
