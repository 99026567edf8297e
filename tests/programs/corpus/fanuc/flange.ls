/PROG  C	Macro
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "P[1] X = 5 mm";
CREATE		= DATE 23-07-09  TIME 09:02:48;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
/MN
   1:J P[1] 10% FINE     ;
   2:L P[2] R[1]mm/sec FINE     ;
/POS
P[1]{
   GP1:
	UF : 0, UT : 0,		J1=    10.000 deg,	J2=   -20.000 deg,	J3=    30.000 deg,	J4=     0.000 deg,	J5=    60.000 deg,	J6=     0.000 deg
};
P[2]{
   GP1:
	UF : 0, UT : 0,		<5|tool0|wobj0>
};
/END
