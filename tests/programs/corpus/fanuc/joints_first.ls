/PROG  B	Macro
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "P[1] X = 5 mm";
CREATE		= DATE 23-07-09  TIME 09:02:48;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
/MN
   1:J P[1] 10% FINE     ;
   2:  LBL[1] ;
   3:  IF DI[1]=ON,JMP LBL[1] ;
   4:L P[2] 100mm/sec CNT10     ;
   5:L P[3] 100mm/sec FINE Wjnt     ;
   6:  CALL OTHER(1,'P[1]') ;
   7:  !L P[9] is a remark ;
/POS
P[1]{
   GP1:
	UF : 1, UT : 2,		J1=    10.000 deg,	J2=   -20.000 deg,	J3=    30.000 deg,	J4=     0.000 deg,	J5=    60.000 deg,	J6=     0.000 deg
};
P[2]{
   GP1:
	UF : 1, UT : 2,		<3|torch|fixture>
};
P[3]{
   GP1:
	UF : 0, UT : 2,		<4|torch|wobj0>
};
/END
