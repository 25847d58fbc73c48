from setuptools import find_packages, setup

setup(
    name="nmt_study",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_study"]),
        ("share/nmt_study", ["package.xml"]),
    ],
    install_requires=[
        "jinja2>=3.1",
        "matplotlib>=3.6",
        "nfoursid>=1.0.2",
        "numpy>=1.26",
        "pandas>=2.0",
        "rich>=13.7",
        "scipy>=1.11",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="The paper's studies: cases, references, figures and findings",
    license="Apache-2.0",
    entry_points={"nmt.commands": ["study = nmt_study.study_command"]},
)
